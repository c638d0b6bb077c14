"""An XML file that grows is valid at any instant."""

from xml.etree import ElementTree as ET

import pytest

from dolfinx_nts.io.formats import xml_series
from dolfinx_nts.io.formats.xml_series import XmlSeries
from helpers.killed import Killed, kill_at

pytestmark = pytest.mark.serial

HEAD, TAIL = "<all>\n", "</all>\n"
NUM_ELEMENTS = 25


@pytest.fixture
def series(tmp_path, monkeypatch):
    """Return a series with little reserved space."""
    monkeypatch.setattr(xml_series, "_FIRST_ROOM", 100)
    return XmlSeries(tmp_path / "a.xml", HEAD, TAIL)


def element(number):
    """Element of an unusual length."""
    return f'<item number="{number}">{"x" * (7 * number % 11)}</item>\n'


def numbers(path):
    """Elements that a reader finds."""
    return [int(item.get("number")) for item in ET.parse(path).getroot()]


def test_each_element_is_there_at_once(tmp_path, series):
    series.start([])
    for number in range(NUM_ELEMENTS):
        assert numbers(tmp_path / "a.xml") == list(range(number))
        series.append(element(number))
    series.close()
    text = HEAD + "".join(f"      {element(number)}" for number in range(NUM_ELEMENTS)) + TAIL
    assert (tmp_path / "a.xml").read_text() == text
    assert [path.name for path in tmp_path.iterdir()] == ["a.xml"]


def test_resumed_file_equals_an_uninterrupted_one(tmp_path, series):
    series.start(element(number) for number in range(3))
    series.append(element(3))
    series.close()
    parts = (tmp_path / "a.xml").read_text()
    series.start([])
    for number in range(4):
        series.append(element(number))
    series.close()
    assert (tmp_path / "a.xml").read_text() == parts


def test_file_is_replaced_ever_more_rarely(series, monkeypatch):
    sizes = []
    replace = xml_series.replace
    monkeypatch.setattr(
        xml_series, "replace", lambda path, image: (sizes.append(len(image)), replace(path, image))
    )
    series.start([])
    for number in range(1000):
        series.append(element(number))
    assert len(sizes) < 12 and sum(sizes) < 5 * sizes[-1]


def test_file_is_valid_after_a_kill_at_any_instant(tmp_path, series, monkeypatch):
    path, count, lengths, done = tmp_path / "a.xml", 0, set(), False
    while not done:
        count += 1
        series.start([element(0)])
        with monkeypatch.context() as patch:
            kill_at(patch, count)
            try:
                for number in range(1, NUM_ELEMENTS):
                    series.append(element(number))
                series.close()
                done = True
            except Killed:
                pass
        found = numbers(path)
        assert found == list(range(len(found)))
        lengths.add(len(found))
    assert lengths == set(range(1, NUM_ELEMENTS + 1)) and count > 2 * NUM_ELEMENTS


def test_after_an_error_the_file_is_valid_and_can_grow(tmp_path, series, monkeypatch):
    for failing in range(1, 4):
        series.start([element(0)])
        put, calls = xml_series._put, 0

        def half(file, place, data, put=put, failing=failing):
            nonlocal calls
            calls += 1
            put(file, place, data[: len(data) // 2] if calls == failing else data)
            if calls == failing:
                raise OSError

        with monkeypatch.context() as patch:
            patch.setattr(xml_series, "_put", half)
            with pytest.raises(OSError):
                series.append(element(1))
        found = numbers(tmp_path / "a.xml")
        assert found == [0, 1][: 1 + (failing == 3)]
        series.append(element(2))
        assert numbers(tmp_path / "a.xml") == [*found, 2]
