"""USD files that would make the library open devices, nest or grow without end."""

import os

import pytest

from rainsim.errors import InputError
from rainsim.scene import usd_guard
from rainsim.scene.shot import read_shot

CAMERA = 'def Camera "Cam"\n{\n}\n'
DEEP = 'def "a"\n{\n' * 50_000 + "}\n" * 50_000


def usda(folder, text, name="a.usda"):
    (folder / name).write_text("#usda 1.0\n" + text, encoding="utf-8")
    return folder / name


def dies(path):
    os.abort()


def grows(path):
    usd_guard._allow(0, 0)
    return len(bytearray(1 << 30))


def test_a_process_of_its_own_may_end(tmp_path):
    pytest.importorskip("pxr")
    path = usda(tmp_path, CAMERA)
    for function in (dies, grows):
        with pytest.raises(InputError, match="OpenUSD breaks off, or takes too much memory"):
            usd_guard.apart(function, path)
    with pytest.raises(InputError, match=r"at most 200 levels|nests more than 200"):
        read_shot(usda(tmp_path, DEEP))


def test_only_regular_files_are_opened(tmp_path):
    pytest.importorskip("pxr")
    os.mkfifo(tmp_path / "pipe.usda")
    for name in ("./pipe.usda", "/dev/zero"):
        for arc in ("references", "payload"):
            path = usda(tmp_path, f'{CAMERA}def "A" ({arc} = @{name}@)\n{{\n}}\n', f"{arc}.usda")
            with pytest.raises(InputError, match="is a pipe or a device"):
                read_shot(path)
    clips = "clips = { dictionary default = { asset[] assetPaths = [@./pipe.usda@] } }"
    with pytest.raises(InputError, match="has value clips"):
        read_shot(usda(tmp_path, f'{CAMERA}def "A" ({clips})\n{{\n}}\n', "clips.usda"))
    usda(tmp_path, CAMERA, "beside.usda")
    (tmp_path / "inner").mkdir()
    above = 'def "A" (references = @../beside.usda@</Cam>)\n{\n}\n'
    assert len(read_shot(usda(tmp_path / "inner", above)).cameras) == 1


def test_references_of_references_are_counted(tmp_path, monkeypatch):
    pytest.importorskip("pxr")
    monkeypatch.setattr(usd_guard, "MOST_PRIMS", 500)
    twice = "".join(
        f'def "P{i}"\n{{\ndef "a" (references = </P{i + 1}>)\n{{\n}}\n'
        f'def "b" (references = </P{i + 1}>)\n{{\n}}\n}}\n'
        for i in range(40)
    )
    with pytest.raises(InputError, match="has more than 500 prims"):
        usd_guard.require_tame(usda(tmp_path, f'{CAMERA}{twice}def "P40"\n{{\n}}\n'))
