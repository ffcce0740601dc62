"""The bench of big captures, on a short street."""

import pytest

from benchmarks import lod


@pytest.mark.slow
def test_a_short_street(tmp_path):
    told = []
    found = lod.run(quick=True, say=told.append, length=40.0, folder=tmp_path / "street")
    exact, fine, coarse = found["rows"]
    assert exact["detail"] == 0 and fine["median_db"] > 30 > coarse["median_db"] > 20
    assert exact["splats"] > fine["splats"] > coarse["splats"] > 0
    assert found["cut"]["same"] and found["cut"]["legs"] == 1  # of wide cells
    assert [row["leg"] for row in found["drive"]] == [True] + [False] * (lod.STRETCH - 1)
    for row in found["drive"]:
        assert abs(row["residual"]) < 1e-6 and row["peak"] >= row["resident"] > 0
    for row in found["alone"]:
        assert row["splats"] > 1000 and row["cpu_ms"] > 0 and row["alone_ms"] > 0
    table = lod.table(found)
    assert "the same bytes" in table and "only these are held" in table
    assert any("cut" in line for line in told)


@pytest.mark.slow
def test_a_short_street_from_end_to_end(tmp_path):
    found = lod.run(quick=True, length=40.0, folder=tmp_path / "street", whole=True)
    rows = found["drive"]
    assert [row["frame"] for row in rows] == list(range(0, 76, 3))
    assert rows[0]["leg"] and rows[-1]["x"] - rows[0]["x"] > 30
    for row in rows:
        assert abs(row["residual"]) < 1e-6 and row["peak"] >= row["resident"] > 0
    table = lod.table(found)
    assert "GB at most" in table and table.count("\n") > 10
