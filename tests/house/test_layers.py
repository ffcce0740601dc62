"""The architecture as a test: who may import what, and who may name what."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest
from counts import circles, imports_of

from source import nodes, tree

PACKAGE = Path(__file__).resolve().parent.parent.parent / "rainsim"
MODULES = sorted(PACKAGE.rglob("*.py"))
# A stage imports from itself and from the lines before it; stages of one line may use each other.
ORDER = """
errors jit constants ledger compiling
numerics
config io
scene actors
splatting
raster
surface
lod
demo_scenes
terrain
rain
drops
water
grid
shading
daylight
ssr
reflection particles
simulation
render
cuda
backend
output_folder
pipeline
world
farm
sensors
datasets
view
commands
cli
__main__
""".strip().splitlines()
RANK = {stage: rank for rank, line in enumerate(ORDER) for stage in line.split()}
MOST_IN_THE_ROOT = 14
DOORS = {"grid", "drops", "raster", "ssr", "cli"}
# Imports against the order, each with its reason.
EXCEPTIONS = {
    # Built-in scenes are looked up by name as captures are, and made only when they are asked for.
    ("scene.library", "demo_scenes.bicycle"),
    ("scene.library", "demo_scenes.street"),
    ("scene.library", "demo_scenes.traffic"),
}


def _name(path):
    return path.relative_to(PACKAGE).as_posix()


def _module(path):
    return _name(path).removesuffix(".py").replace("/", ".").removesuffix(".__init__")


KNOWN = {_module(path) for path in MODULES}


@functools.cache
def _imports(path):
    """All modules that a file imports, at its top, inside functions or by a name in a string."""
    assert not any(isinstance(n, ast.ImportFrom) and n.level for n in nodes(path)), _name(path)
    return imports_of(tree(path))


def _of_ours(path):
    """The files of ours that a file imports, as names below `rainsim`."""
    names = {name.removeprefix("rainsim.") for name in _imports(path) if name != "rainsim"}
    found = set()
    for name in names & KNOWN | {name.rpartition(".")[0] for name in names} & KNOWN:
        inner = {other for other in names & KNOWN if other.startswith(f"{name}.")}
        if not (inner and (PACKAGE / name.replace(".", "/")).is_dir()):
            found.add(name)
    return found - {_module(path), ""}


def _users(module):
    """The files that import a module or something in it."""
    return {
        _name(path)
        for path in MODULES
        if any(name == module or name.startswith(f"{module}.") for name in _imports(path))
    }


def _in_cli(names):
    return {name for name in names if name == "cli.py" or name.startswith("commands/")}


def test_the_walk_finds_imports():
    assert "rainsim.errors" in _imports(PACKAGE / "config/settings.py")
    assert "pipeline.py" in _users("rainsim.errors")
    assert "demo_scenes.bicycle" in _of_ours(PACKAGE / "scene/library.py")
    assert "errors" in _of_ours(PACKAGE / "config/settings.py")


def test_the_root_is_a_table_of_contents():
    files = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    assert len(files) <= MOST_IN_THE_ROOT
    assert files >= DOORS
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert files | rooms == set(RANK), "each room has its place in ORDER above"


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_imports_follow_the_order(path):
    here = _module(path)
    rank = RANK.get(here.partition(".")[0], len(ORDER))
    for other in _of_ours(path):
        allowed = RANK[other.partition(".")[0]] <= rank or (here, other) in EXCEPTIONS
        assert allowed, f"{here} imports {other} from above: move what both need down, see ORDER"


def test_no_circle_between_files_is_left():
    edges = {_module(path): _of_ours(path) for path in MODULES if _module(path) != "__init__"}
    edges["scene.library"] -= {other for here, other in EXCEPTIONS if here == "scene.library"}
    assert len(edges) > 100
    assert not circles(edges)


COMPILERS = {"jit.py", "cuda/jit.py"}  # one for each backend
OPTIONS = {"fastmath", "nogil", "error_model", "parallel", "forceinline"}


def test_only_jit_imports_numba():
    users = _users("numba")
    assert COMPILERS <= users
    names = ("callees", "checked_files", "kernel_cache", "parts", "signatures")
    kernels_on_disk = {f"compiling/{n}.py" for n in names}
    gpu = {f"cuda/{n}.py" for n in ("__init__", "kernel_cache", "launch", "scalars", "warp")}
    assert users <= COMPILERS | kernels_on_disk | gpu


def test_nothing_needs_cuda_before_it_is_asked_for():
    for path in MODULES:
        if _name(path).startswith("cuda/"):
            continue
        for node in tree(path).body:  # not inside functions
            if isinstance(node, ast.ImportFrom | ast.Import):
                names = [getattr(node, "module", None) or "", *(a.name for a in node.names)]
                assert not any(name.startswith("rainsim.cuda.") for name in names), _name(path)


def test_only_images_imports_imageio():
    assert _users("imageio") | _users("PIL") == {"io/images.py"}
    assert _users("imageio_ffmpeg") == {"io/video.py"}


def test_only_the_command_line_imports_click():
    users = _users("click")
    assert users and users == _in_cli(users)


def test_nothing_but_the_entry_imports_the_command_line():
    users = _users("rainsim.cli") | _users("rainsim.commands")
    assert users - _in_cli(users) == {"__main__.py"}


def test_the_package_needs_no_benchmarks():
    assert not _users("benchmarks")


def test_progress_bars_belong_to_the_command_line():
    assert _users("tqdm") == {"commands/status.py"}


def test_compiler_options_are_named_in_one_place():
    for path in MODULES:
        names = {
            keyword.arg
            for node in nodes(path)
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
