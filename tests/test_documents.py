"""README and pages are correct: commands and edits run, and numbers are computed values."""

import ast
import csv
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from benchmarks import impact, plane, rings
from helpers import verified
from helpers.scenes import blocks
from helpers.verified import ROUND_OFF, numbers

pytestmark = pytest.mark.serial

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCS = ROOT / "docs"
PAGES = sorted({*DOCS.rglob("*.md"), *ROOT.glob("*.md")} - {*DOCS.glob("api/*")})


def block(kind: str) -> str:
    """The first block of a kind in the README."""
    found = re.search(rf"```{kind}\n(.*?)```", README, re.DOTALL)
    assert found
    return found[1]


SCRIPT = block("python")


def variants() -> list[tuple[list[str], list[str]]]:
    """Edits in the table of variants: old texts and new texts of each row."""
    lines = (DOCS / "howto" / "variants.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split(" | ") for line in lines if line.startswith("| `")]
    return [(re.findall(r"`([^`]+)`", old), re.findall(r"`([^`]+)`", new)) for old, new, _ in rows]


def execute(script: str, monkeypatch, folder: Path) -> dict[str, object]:
    """Run a script next to the mesh, with results in a folder; return its global names."""
    (folder / "meshes").symlink_to(ROOT / "meshes")
    monkeypatch.chdir(folder)
    names: dict[str, object] = {}
    exec(compile(script, "README.md", "exec"), names)
    return names


def test_readme_is_short():
    assert len(README.splitlines()) <= 110
    assert len(README.split()) <= 800


def test_readme_script_prints_as_in_the_readme_without_gmsh(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "gmsh", None)  # as if it were not installed
    execute(SCRIPT, monkeypatch, tmp_path)
    printed = capsys.readouterr().out.splitlines()
    for line in block("text").splitlines():
        (same,) = (p for p in printed if p.split(":")[0] == line.split(":")[0])
        for computed, published in zip(numbers(same), numbers(line), strict=True):
            if abs(published) < ROUND_OFF:
                assert abs(computed) < ROUND_OFF
            else:
                assert computed == pytest.approx(published, rel=1e-5)
    files = re.search(r"as record:  # (.+) and (.+)", SCRIPT)
    assert files and all((tmp_path / name).stat().st_size > 0 for name in files.groups())


@pytest.mark.parametrize(("old", "new"), variants(), ids=lambda texts: " and ".join(texts))
def test_variant_of_the_script_runs_until_bodies_touch(old, new, tmp_path, monkeypatch):
    script = SCRIPT.replace("until=2.0", "until=0.08")
    for before, after in zip(old, new, strict=True):
        assert before in script, f"the script has no {before}"
        script = script.replace(before, after)
    names = execute(script, monkeypatch, tmp_path)
    assert names["step"].num_active > 0


def test_links_to_files_have_targets():
    broken = []
    for page in PAGES:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            path = link.split("#")[0]
            if path and "://" not in path:
                names = (path, f"{path}.md", f"{path}.py")
                if not any((page.parent / name).exists() for name in names):
                    broken.append(f"{page.relative_to(ROOT)}: {link}")
    assert not broken, "\n".join(broken)


def test_make_targets_in_readme_and_pages_exist():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        named = re.findall(r"`make ([a-z-]+)|^    make ([a-z-]+)", text, re.MULTILINE)
        assert {first or second for first, second in named} <= targets, page


def test_each_demo_is_a_tutorial():
    listed = re.findall(r"^demos/([\w/]+)$", (DOCS / "tutorials.md").read_text(), re.MULTILINE)
    demos = (path.relative_to(ROOT / "demos") for path in (ROOT / "demos").rglob("*.py"))
    assert sorted(listed) == sorted(path.with_suffix("").as_posix() for path in demos)


def test_all_columns_of_a_table_are_explained(comm, tmp_path):
    page = (DOCS / "howto" / "columns.md").read_text(encoding="utf-8")
    cells = [line.split(" | ")[0] for line in page.splitlines() if line.startswith("| `")]
    explained = [name for cell in cells for name in re.findall(r"`([a-z_0-9]+)`", cell)]
    old = blocks(comm).stepper
    bcs = [fem.dirichletbc(np.zeros(3), old.bodies[0].nodes[:1], old.bodies[0].V)]
    loads = [nts.Gravity(old.bodies, (0, 0, -1))]
    floor = nts.ContactPair(
        old.pairs[0].nodes,
        nts.RigidPlane((0, 0, -9), (0, 0, 1)),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    pairs = [*old.pairs, floor]
    stepper = nts.EnergyMomentum(old.bodies, pairs, dt=0.1, bcs=bcs, loads=loads)
    parts = ("pairs", "between", "obstacles", "supports", "loads", "bodies")
    with nts.Recorder(tmp_path / "run", stepper, columns_of=parts):
        pass
    with (tmp_path / "run.csv").open(newline="") as file:
        columns = next(csv.reader(file))
    names = "pair_surface_3_(?:surface_2|rigid_plane)|obstacle_rigid_plane|support_1|load_gravity"
    names += "|body_[01]|between_body_0_body_1|between_0_1"
    plain = [re.sub(f"^(?:{names})_", lambda m: f"{m[0].split('_')[0]}_name_", c) for c in columns]
    assert sorted(set(plain)) == sorted(explained)


def test_explained_messages_exist_in_the_package():
    page = (DOCS / "howto" / "troubleshooting.md").read_text(encoding="utf-8")
    quoted = re.findall(r'^"(.+)"$', page, re.MULTILINE)
    texts = []
    for path in (ROOT / "dolfinx_nts").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        texts += [str(n.value) for n in ast.walk(tree) if isinstance(n, ast.Constant)]
    assert len(quoted) > 10
    for message in quoted:
        parts = message.split("...")
        assert any(all(part in text for part in parts) for text in texts), message


def test_table_of_the_impact_agrees_with_the_runs(tmp_path):
    lines = (DOCS / "tables" / "impact.md").read_text(encoding="utf-8").splitlines()
    names = [line.split(" | ")[0].removeprefix("| ") for line in lines[2:] if line.startswith("|")]
    assert names == list(impact.VARIANTS)
    name = "`Midpoint`, plastic"
    computed = impact.table({name: impact.run(name, 1.0, tmp_path)}).splitlines()[2]
    (published,) = (line for line in lines if line.startswith(f"| {name} "))
    assert numbers(computed) == pytest.approx(numbers(published), rel=0.02, abs=ROUND_OFF)


@pytest.mark.parametrize("bench", [plane, rings], ids=["plane", "rings"])
def test_tables_of_two_dimensions_agree_with_their_commands(bench, capsys):
    published = (DOCS / "tables" / f"{bench.__name__.split('.')[1]}.md").read_text(encoding="utf-8")
    bench.main([])
    heads = capsys.readouterr().out
    assert published.startswith(heads) and published.count("\n") == 5
    if bench is plane:
        rows = published.splitlines()[2:]
        for n, row in zip((25, 50), rows, strict=False):
            assert numbers(row)[1] == plane.scene(n, 2)[1].u.x.array.size


def test_per_cents_in_the_text_occur_in_a_table():
    """Tables are written by commands, and what a sentence says is in one of them."""
    tables = "".join(path.read_text(encoding="utf-8") for path in (DOCS / "tables").glob("*.md"))
    measured = {token.lstrip("+-") for token in re.findall(r"[-+]?\d+(?:\.\d+)?", tables)}
    pages = set(PAGES) & {*DOCS.rglob("*.md")} - {*DOCS.glob("tables/*")}
    for text in (README, *(page.read_text(encoding="utf-8") for page in pages)):
        for number in re.findall(r"(\d+(?:\.\d+)?) (?:to \d+(?:\.\d+)? )?%", text):
            assert number in measured, f"{number} %"
        for number in re.findall(r"to (\d+(?:\.\d+)?) %", text):
            assert number in measured, f"{number} %"


def test_numbers_of_other_codes_in_the_readme_agree_with_their_table():
    table = (DOCS / "tables" / "peers.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    by_code = {row[0].split()[0]: row for row in reversed(rows)}  # of ours the first row
    order = [by_code[code] for code in ("dolfinx_nts", "CalculiX", "GetFEM", "IPC")]
    (sentence,) = (line for line in README.splitlines() if "CPU s here" in line)
    seconds, changes = ([abs(float(row[column])) for row in order] for column in (4, 6))
    assert numbers(sentence) == [*seconds, *changes]


def test_version_is_the_same_everywhere():
    assert f"version: {nts.__version__}" in (ROOT / "CITATION.cff").read_text()
    assert f"version: {nts.__version__}" in (ROOT / "packaging/conda/recipe.yaml").read_text()
    dated = re.search(r"^date-released: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert dated
    assert f"## [{nts.__version__}] - {dated[1]}" in (ROOT / "CHANGELOG.md").read_text()


def test_shell_blocks_of_the_cluster_page_are_scripts():
    text = (DOCS / "howto" / "cluster.md").read_text(encoding="utf-8")
    (script,) = re.findall(r"```bash\n(.*?)```", text, re.DOTALL)
    subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_rows_of_the_page_on_verification_are_measured_by_tests():
    cases = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            is_row = isinstance(node, ast.Call) and getattr(node.func, "id", "") == "table_row"
            if is_row and node.args:
                cases.append((path.name, _pattern(node.args[0])))
    rows = verified.read()
    for row in rows:
        found = [p for name, p in cases if row.path.endswith(name) and re.fullmatch(p, row.case)]
        assert found, row.case
    for name, pattern in cases:
        assert any(re.fullmatch(pattern, row.case) for row in rows), (name, pattern)


def _pattern(text: ast.expr) -> str:
    """Regular expression of a text in the source with placeholders."""
    parts = text.values if isinstance(text, ast.JoinedStr) else [text]
    return "".join(re.escape(p.value) if isinstance(p, ast.Constant) else ".+" for p in parts)


def test_each_public_name_has_its_place_in_the_reference():
    (table,) = (
        node.value
        for node in ast.parse((DOCS / "_extensions" / "api_pages.py").read_text()).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "PARTS"
    )
    words = [n.value for n in ast.walk(table) if isinstance(n, ast.Constant)]
    headings = [key.value for key in table.keys if isinstance(key, ast.Constant)]
    assert sorted(set(words) - set(headings)) == sorted(nts.__all__)
    assert len(words) == len(headings) + len(nts.__all__)
