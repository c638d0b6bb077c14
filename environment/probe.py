"""Print the prefix of this Python and what identifies it; exit 1 without DOLFINx >= 0.9."""

import sys
from importlib.metadata import PackageNotFoundError, version

try:
    dolfinx = version("fenics-dolfinx")
except PackageNotFoundError:
    sys.exit(1)
if tuple(int(part) for part in dolfinx.split(".")[:2]) < (0, 9):
    sys.exit(1)
print(sys.prefix)
print(sys.prefix, sys.version, "DOLFINx", dolfinx, "NumPy", version("numpy"))
