"""A cylinder pressed onto a block and dragged over it, in other codes, evaluated by one routine.

``python3 -m benchmarks.press`` prints a table. The scene is `scene`, what is read off the nodes
of every code alike is in `judge`.
"""
