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
    # The comparison with other codes is a separate run.
    tables = {"tables.md": "benchmarks.md", "peers.md": "peers.md", "defaults.md": "defaults.md"}
    for table, page in tables.items():
        if (folder / table).exists():
            shutil.copy(folder / table, root / "docs" / "tables" / page)


if __name__ == "__main__":
    publish(Path("results/bench"))
