"""`rainsim doctor` tells what there is and what is wrong."""

import json

import numpy as np

import rainsim.commands.environment
from rainsim.io import cache


def test_doctor_tells_threads_backends_and_cache(rainsim):
    done = rainsim("doctor", "--json")
    found = json.loads(done.out)
    assert found["backends"]["cpu"]["ready"] and found["threads"]["number"] >= 1
    assert found["threads"]["layer"] in ("workqueue", "omp", "tbb")
    gpu = found["backends"]["cuda"]
    assert gpu["ready"] or 'pip install "rainsim[cuda]"' in gpu["why"] or "driver" in gpu["why"]
    assert found["cache"]["writable"] and found["versions"]["numba"]
    assert done.code == (1 if found["wrong"] else 0)


def test_what_is_wrong_comes_with_its_remedy(monkeypatch, tmp_path):
    found = rainsim.commands.environment.report()
    assert "threads" in rainsim.commands.environment.table(found)
    monkeypatch.setattr(rainsim.commands.environment, "threading_layer", lambda: ("workqueue", 1))
    monkeypatch.setattr(rainsim.commands.environment, "cores", lambda: 8)
    monkeypatch.setattr(rainsim.commands.environment, "CACHE_FOLDER", tmp_path)
    wrong = rainsim.commands.environment.report()["wrong"]
    assert any("NUMBA_NUM_THREADS" in line for line in wrong)
    assert any("NUMBA_CACHE_DIR" in line for line in wrong)
    assert "WRONG" in rainsim.commands.environment.table(rainsim.commands.environment.report())


def test_doctor_tells_the_folder_of_kept_results_and_its_size(monkeypatch, tmp_path):
    monkeypatch.setenv("RAINSIM_CACHE", "off")
    report, table = rainsim.commands.environment.report, rainsim.commands.environment.table
    assert report()["results"]["folder"] is None and "RAINSIM_CACHE is off" in table(report())
    monkeypatch.setenv("RAINSIM_CACHE", str(tmp_path / "kept"))
    assert report()["results"] == {
        "folder": str(tmp_path / "kept"), "entries": 0, "size": 0, "writable": True,
    }  # fmt: skip
    cache.write("test", "one", {}, {"zeros": np.zeros(2_000_000)})
    found = report()
    assert found["results"]["entries"] == 1 and 16e6 < found["results"]["size"] < 16.1e6
    assert f"{tmp_path / 'kept'}: 16 MB in 1 kept" in table(found)
