"""The cost of an installation is measured with a real one."""

import pytest

from experiments.bench import footprint

pytestmark = pytest.mark.slow


def test_an_installation_reads_a_photo_and_rows_of_landmarks(tmp_path, monkeypatch):
    monkeypatch.setattr(footprint, "_REPEATS", 1)
    monkeypatch.setattr(footprint, "_ROWS", 10)
    values = {measure: value for measure, value, _ in footprint.measure("dlib", tmp_path)}
    assert values["pip install"] > values["one photo, warm"]
    assert 100 < values["size of what is installed"] < 2000
    assert 0 < values["one photo, warm"] < values["one photo, cold"]
    assert "10 rows to CSV" in values
    assert '"rows-10"' in (tmp_path / "out/rows.csv").read_text()
