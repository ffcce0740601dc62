"""The public names: they are there, load lazily, are documented, and their examples run."""

import doctest
import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rainsim

NAMES = [name for name in rainsim.__all__ if name != "__version__"]
FUNCTIONS = [n for n in NAMES if n != "AOVS" and not n.endswith("Error")]


def test_dir_lists_the_public_names(root):
    stub = (root / "rainsim/__init__.pyi").read_text(encoding="utf-8")
    assert stub.count("\nfrom ") == len(NAMES) and (root / "rainsim/py.typed").is_file()
    assert set(dir(rainsim)) == set(rainsim.__all__)
    assert all(hasattr(rainsim, name) for name in NAMES)
    with pytest.raises(AttributeError, match="no_such_name"):
        rainsim.no_such_name  # noqa: B018


def test_the_package_loads_nothing_before_it_is_used():
    code = "import sys, rainsim; assert dir(rainsim); print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_parameters_are_documented(name):
    value = getattr(rainsim, name)
    text = inspect.getdoc(value)
    assert text and len(text) > 30
    parameters = list(inspect.signature(value).parameters)
    for parameter in parameters:
        assert re.search(rf"\b{parameter}\b", text), parameter


@pytest.fixture(scope="module")
def example(tmp_path_factory, scene_folder):
    """A folder with a capture called my-capture, and what the examples take as given."""
    import os
    import shutil

    folder = tmp_path_factory.mktemp("examples")
    shutil.copytree(scene_folder, folder / "my-capture")
    before = Path.cwd()
    os.chdir(folder)
    scene = rainsim.load_scene("my-capture/")
    config = rainsim.Config.from_preset("moderate").replace(spacing=0.04, extent=1.0)
    terrain = rainsim.extract_terrain(scene, config)
    state = next(rainsim.simulate(terrain, config))
    yield {"scene": scene, "config": config, "terrain": terrain, "state": state}
    os.chdir(before)


def examples():
    finder = doctest.DocTestFinder(recurse=False)
    found = {}
    for name in FUNCTIONS:
        (test,) = finder.find(getattr(rainsim, name), name, globs={})
        found[name] = test
    return found


@pytest.mark.parametrize("name", [n for n, test in examples().items() if test.examples])
def test_examples_run(name, example):
    test = examples()[name]
    test.globs = {"rainsim": rainsim, "np": np, **example}
    runner = doctest.DocTestRunner(verbose=False)
    printed = []
    assert runner.run(test, out=printed.append).failed == 0, "".join(printed)


def test_every_public_name_stands_in_an_example():
    text = "".join(line.source for test in examples().values() for line in test.examples)
    used = set(re.findall(r"rainsim\.(\w+)", text))
    given = {"Scene", "Splats", "Camera", "Terrain", "FrameReport", "Renderer"}  # of `example`
    lacking = [n for n in FUNCTIONS if n not in used and not examples()[n].examples]
    assert not set(lacking) - given, lacking
