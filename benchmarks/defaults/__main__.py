"""Which method and law of contact is the best default.

    python3 -m benchmarks.defaults [--folder FOLDER] [--reference] [SCENE...]

Runs each scene with all settings, in a process of its own, and writes ``defaults.json`` and
``defaults.md``, tables of errors, costs and regrets; scenes that are not named keep their last
results. All take 10 minutes. With ``--reference`` it
computes the ball on the block on fine meshes instead, and prints rebound and peak force.
"""

import argparse
import json
from pathlib import Path

from benchmarks.__main__ import child, progress
from benchmarks.defaults.impacts import ball_on_block
from benchmarks.defaults.regret import Result
from benchmarks.defaults.scenes import SCENES
from benchmarks.defaults.settings import SETTINGS
from benchmarks.defaults.tables import markdown

__all__ = ["main"]


def main() -> None:
    """Run the scenes and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", default=list(SCENES))
    parser.add_argument("--folder", type=Path, default=Path("results/bench"))
    parser.add_argument("--reference", action="store_true")
    arguments = parser.parse_args()
    if arguments.reference:
        print(reference())
        return
    if unknown := [name for name in arguments.scenes if name not in SCENES]:
        parser.error(f"expected scenes among {', '.join(SCENES)}, given {', '.join(unknown)}")
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "defaults.json"
    last = json.loads(path.read_text()) if path.exists() else []
    rows = [row for row in last if row["scene"] not in arguments.scenes]
    for name in arguments.scenes:
        progress(f"defaults: {name}")
        rows += child("benchmarks.defaults.run", name)
        path.write_text(json.dumps(rows, indent=1))
    text = markdown([Result(**row) for row in rows])
    (folder / "defaults.md").write_text(text, encoding="utf-8")
    print(text)


def reference() -> dict[int, dict[str, float]]:
    """Rebound and peak force of the ball on fine meshes, by their cells along an edge."""
    found = {}
    for n, dt in ((12, 0.005), (18, 0.0035)):
        scene = ball_on_block(SETTINGS["resolved, mortar"], n=n, dt=dt)
        for _ in scene.stepper.run(until=scene.t_end):
            scene.record()
        found[n] = scene.judge()
    return found


if __name__ == "__main__":
    main()
