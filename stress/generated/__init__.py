"""Generated cases of contact, judged by a program that shares nothing with the package."""
