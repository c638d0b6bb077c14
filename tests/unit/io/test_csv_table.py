"""Table of a run: contents of the file, and continuation."""

import pytest

from dolfinx_nts.io.csv_table import Table

pytestmark = pytest.mark.serial


@pytest.fixture
def path(tmp_path):
    """File of this rank."""
    return tmp_path / "run.csv"


def test_names_come_first_and_each_row_is_on_disk_at_once(path):
    table = Table(path)
    table.open(["step", "time"], resume=False)
    for i in range(2):
        table.write({"step": i, "time": 0.1 * i})
        assert path.read_text().split() == ["step,time", "0,0.0", "1,0.1"][: i + 2]
    table.close()


def test_resumed_table_goes_on_after_the_last_sync(path):
    table = Table(path)
    table.open(["step"], resume=False)
    table.write({"step": 0})
    table.sync()
    table.write({"step": 1})
    table.close()
    again = Table(path)
    again.size, again.digest = table.size, table.digest
    again.open(["step"], resume=True)
    again.write({"step": 2})
    again.close()
    assert path.read_text().split() == ["step", "0", "2"]


def test_table_that_is_too_short_is_refused_and_left_alone(path):
    path.write_text("step\r\n")
    table = Table(path)
    table.size = 100
    with pytest.raises(ValueError, match=r"of 100 bytes or more, .* given one of 6"):
        table.open(["step"], resume=True)
    table.close()
    assert path.read_bytes() == b"step\r\n"


def test_table_with_other_columns_is_refused_and_left_alone(path):
    table = Table(path)
    table.open(["step", "time"], resume=False)
    table.write({"step": 0, "time": 0.0})
    table.sync()
    table.close()
    before = path.read_bytes()
    reason = r"lacks \['time'\] and adds \['body_ball_mass'\]: record what"
    with pytest.raises(ValueError, match=reason):
        table.open(["step", "body_ball_mass"], resume=True)
    assert path.read_bytes() == before


@pytest.mark.parametrize("damage", [bytes.upper, lambda text: b"0" + text, lambda text: 9 * b"a,b"])
def test_table_with_other_rows_is_refused_and_left_alone(path, damage):
    table = Table(path)
    table.open(["step"], resume=False)
    table.write({"step": 0})
    table.sync()
    table.close()
    path.write_bytes(damage(path.read_bytes()))
    before = path.read_bytes()
    table.close()
    with pytest.raises(ValueError, match="given other rows; restore the table"):
        table.open(["step"], resume=True)
    assert path.read_bytes() == before
