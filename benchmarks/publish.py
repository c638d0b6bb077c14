"""Put the figures and tables of the last run into the documentation."""

import shutil
from pathlib import Path

__all__ = ["publish"]

ROOT = Path(__file__).parents[1]


def publish(folder: Path, root: Path = ROOT) -> None:
    """Copy figures and tables, which ``docs/benchmarks.md`` shows.

    Args:
        folder: Where the benchmark wrote its results.
        root: Of the repository.
    """
    for figure in sorted(folder.glob("bench_*.png")):
        shutil.copy(figure, root / "docs" / "figures" / figure.name)
    shutil.copy(folder / "tables.md", root / "docs" / "tables" / "benchmarks.md")


if __name__ == "__main__":
    publish(Path("results/bench"))
