"""Put the figures and tables of the last run into README and docs."""

import shutil
from pathlib import Path

ROOT = Path(__file__).parents[1]

BEGIN, END = "<!-- make bench-publish writes from here -->", "<!-- to here -->"


def publish(folder: Path, root: Path = ROOT) -> None:
    """Copy figures and tables; the README gets the first two tables.

    Args:
        folder: Where the benchmark wrote its results.
        root: Of the repository.
    """
    for figure in sorted(folder.glob("bench_*.png")):
        shutil.copy(figure, root / "docs" / "figures" / figure.name)
    tables = (folder / "tables.md").read_text()
    (root / "docs" / "benchmarks.md").write_text(f"# Benchmarks\n\n{tables}")
    readme = root / "README.md"
    before, remainder = readme.read_text().split(BEGIN)
    _, after = remainder.split(END)
    summary = "\n\n".join(tables.split("\n\n")[:2])
    readme.write_text(f"{before}{BEGIN}\n\n{summary}\n\n{END}{after}")


if __name__ == "__main__":
    publish(Path("results/bench"))
