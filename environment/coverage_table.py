"""Print the table of lines that tests execute, by package, from reports of coverage.py and gcovr.

Fails if fewer than the least fractions are executed.
"""

import json
import sys
from collections import defaultdict
from pathlib import Path, PurePath

# Least fractions of executed lines [%].
LEAST = {"Python": 95.0, "C++": 90.0}


def main(python: str, cpp: str) -> None:
    """Print the table of two reports in JSON."""
    packages: defaultdict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])

    def add(language: str, package: str, covered: int, lines: int) -> None:
        for name in package, "all":
            sums = packages[language, name]
            sums[0] += covered
            sums[1] += lines

    for name, of_file in json.loads(Path(python).read_text())["files"].items():
        parts = PurePath(name).parts
        parts = parts[parts.index("dolfinx_nts") + 1 :]
        numbers = of_file["summary"]
        package = parts[0] if len(parts) > 1 else "dolfinx_nts"
        add("Python", package, numbers["covered_lines"], numbers["num_statements"])
    for of_file in json.loads(Path(cpp).read_text())["files"]:
        package = "/".join(PurePath(of_file["filename"]).parts[:-1])
        add("C++", package, of_file["line_covered"], of_file["line_total"])
    print("| language | package | lines | executed by tests, % |\n|---|---|---:|---:|")
    for (language, package), (covered, lines) in sorted(packages.items()):
        print(f"| {language} | {package} | {lines} | {100 * covered / lines:.1f} |")
    for language, least in LEAST.items():
        covered, lines = packages[language, "all"]
        if 100 * covered < least * lines:
            sys.exit(f"{language}: {100 * covered / lines:.1f} % of the lines, expected {least} %")


if __name__ == "__main__":
    main(*sys.argv[1:])
