"""USD files that would make the library open devices, nest or grow without end."""

import os
import zipfile

import pytest

from rainsim.errors import InputError
from rainsim.scene import usd_guard
from rainsim.scene.shot import read_shot

CAMERA = 'def Camera "Cam"\n{\n}\n'
DEEP = 'def "a"\n{\n' * 50_000 + "}\n" * 50_000
BRACKETS_IN_TEXT = f'# {"{" * 999}\ndef "a" (doc = "{"(" * 999}")\n{{\n}}\n'


def usda(folder, text, name="a.usda"):
    (folder / name).write_text("#usda 1.0\n" + text, encoding="utf-8")
    return folder / name


def test_nested_text_is_refused_before_the_library_reads_it(tmp_path):
    path = usda(tmp_path, DEEP)
    with pytest.raises(InputError, match="nests more than 200 levels deep"):
        usd_guard.checked_size(path, path)
    with zipfile.ZipFile(tmp_path / "a.usdz", "w") as archive:
        archive.write(path, "a.usda")
    with pytest.raises(InputError, match="nests more than 200 levels deep"):
        usd_guard.checked_size(path, tmp_path / "a.usdz")
    path = usda(tmp_path, BRACKETS_IN_TEXT + CAMERA)
    assert usd_guard.checked_size(path, path) == path.stat().st_size


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
        read_shot(usda(tmp_path, f'{CAMERA}{twice}def "P40"\n{{\n}}\n'))
