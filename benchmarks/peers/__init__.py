"""The impact of the ball in other codes, evaluated by one routine.

``python3 -m benchmarks.peers`` runs each code in a process of its own and writes
``results/bench/peers.csv`` and a table. The scene is `scene`, what is read off the nodes of
every code alike is in `judge`.
"""
