"""The architecture as a test: who may import what, and who may name what."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent.parent / "rainsim"
BASE = ("rainsim.errors", "rainsim.keys", "rainsim.timeline")
MODULES = sorted(PACKAGE.rglob("*.py"))


def _name(path):
    return path.relative_to(PACKAGE).as_posix()


def _imports(path):
    """All modules that a file imports, at its top or inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{_name(path)} has a relative import"
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def _users(module):
    """The files that import a module or something in it."""
    return {
        _name(path)
        for path in MODULES
        if any(name == module or name.startswith(f"{module}.") for name in _imports(path))
    }


def _in_cli(names):
    return {name for name in names if name.startswith("cli/")}


def test_the_walk_finds_imports():
    assert "rainsim.errors" in _imports(PACKAGE / "config.py")
    assert "render.py" in _users("rainsim.errors")


COMPILERS = {"jit.py", "cuda/jit.py"}  # one for each backend
OPTIONS = {"fastmath", "nogil", "error_model", "parallel", "forceinline"}


def test_only_jit_imports_numba():
    users = _users("numba")
    assert COMPILERS <= users
    assert users <= COMPILERS | {"cuda/__init__.py", "cuda/scalars.py", "cuda/warp.py"}


def test_nothing_needs_cuda_before_it_is_asked_for():
    for path in MODULES:
        if _name(path).startswith("cuda/"):
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:  # not inside functions
            if isinstance(node, ast.ImportFrom | ast.Import):
                names = [getattr(node, "module", None) or "", *(a.name for a in node.names)]
                assert not any(name.startswith("rainsim.cuda.") for name in names), _name(path)


def test_only_image_imports_imageio():
    assert _users("imageio") | _users("imageio_ffmpeg") | _users("PIL") == {"image.py"}


def test_only_the_command_line_imports_click():
    users = _users("click")
    assert users and users == _in_cli(users)


def test_nothing_but_the_entry_imports_the_command_line():
    users = _users("rainsim.cli")
    assert users - _in_cli(users) == {"__main__.py"}


def test_progress_bars_belong_to_the_command_line():
    assert _users("tqdm") == {"cli/status.py"}


def test_the_base_imports_nothing_above_it():
    for base in ("errors.py", "jit.py", "timeline.py", "config.py", "scene/types.py"):
        inside = {name for name in _imports(PACKAGE / base) if name.startswith("rainsim")}
        inside = {name for name in inside if not name.startswith(BASE)}
        assert not inside, f"{base} imports {inside}"


def test_scenes_know_nothing_of_rain():
    above = (
        "rainsim.pipeline rainsim.simulation rainsim.render rainsim.terrain rainsim.grid".split()
    )
    above += ["rainsim.drops", "rainsim.shade", "rainsim.config", "rainsim.raster"]
    for path in (PACKAGE / "scene").rglob("*.py"):
        wrong = {name for name in _imports(path) if name.startswith(tuple(above))}
        assert not wrong, f"{_name(path)} imports {wrong}"


def test_compiler_options_are_named_in_one_place():
    for path in MODULES:
        names = {
            keyword.arg
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call)
            for keyword in node.keywords
        }
        if _name(path) not in COMPILERS:
            assert not names & OPTIONS, _name(path)


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["presets"], ["--version"]])
def test_help_imports_nothing_heavy(arguments):
    code = (
        "import sys, rainsim.cli\n"
        f"sys.argv = ['rainsim', *{arguments!r}]\n"
        "try:\n    rainsim.cli.main()\n"
        "except SystemExit as end:\n    assert not end.code, end.code\n"
        "heavy = {'numba', 'numpy', 'scipy', 'imageio', 'tqdm', 'PIL'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_the_public_names_exist():
    import rainsim

    for name in rainsim.__all__:
        assert getattr(rainsim, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = rainsim.nothing
