"""`rainsim doctor` tells what there is and what is wrong."""

import json

import rainsim.doctor


def test_doctor_tells_threads_backends_and_cache(rainsim):
    done = rainsim("doctor", "--json")
    found = json.loads(done.out)
    assert found["backends"]["cpu"]["ready"] and found["threads"]["number"] >= 1
    assert found["threads"]["layer"] in ("workqueue", "omp", "tbb")
    gpu = found["backends"]["cuda"]
    assert gpu["ready"] or "pip install rainsim[cuda]" in gpu["why"] or "driver" in gpu["why"]
    assert found["cache"]["writable"] and found["versions"]["numba"]
    assert done.code == (1 if found["wrong"] else 0)


def test_what_is_wrong_comes_with_its_remedy(monkeypatch, tmp_path):
    found = rainsim.doctor.report()
    assert "threads" in rainsim.doctor.table(found)
    monkeypatch.setattr(rainsim.doctor, "threading_layer", lambda: ("workqueue", 1))
    monkeypatch.setattr(rainsim.doctor.os, "cpu_count", lambda: 8)
    monkeypatch.setattr(rainsim.doctor, "CACHE_FOLDER", tmp_path)
    wrong = rainsim.doctor.report()["wrong"]
    assert any("NUMBA_NUM_THREADS" in line for line in wrong)
    assert any("NUMBA_CACHE_DIR" in line for line in wrong)
    assert "WRONG" in rainsim.doctor.table(rainsim.doctor.report())
