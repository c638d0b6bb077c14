"""Generated contact cases, judged by a program that shares no code with the package."""
