"""House rules that a script can check: sizes, documentation, and what files must not say."""

import ast
import configparser
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks.__main__ import benchmarks
from rainsim.cli import cli
from source import nodes, tree

ROOT = Path(__file__).resolve().parent.parent.parent
EXAMPLES = sorted(ROOT.glob("examples/**/*.py"))
CODE = *ROOT.glob("rainsim/**/*.py"), *ROOT.glob("benchmarks/*.py")
SOURCES = sorted([*CODE, *EXAMPLES])
TEXTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
README = (ROOT / "README.md").read_text(encoding="utf-8")
LONGEST_FILE = 500
LONGEST_EXAMPLE = 60


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_files_are_short_and_lines_fit(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    longest = LONGEST_EXAMPLE if path in EXAMPLES else LONGEST_FILE
    assert len(lines) <= longest, f"{len(lines)} lines; split the file by subject, or delete"
    assert max(map(len, lines), default=0) <= 100, "break the lines that are longer than 100"


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_everything_public_has_a_docstring(path):
    module = tree(path)
    kinds = (ast.FunctionDef, ast.ClassDef)
    assert ast.get_docstring(module), "the module has no docstring"
    for node in module.body:
        if isinstance(node, kinds) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{node.name} has no docstring"
            for inner in node.body if isinstance(node, ast.ClassDef) else ():
                if isinstance(inner, ast.FunctionDef) and not inner.name.startswith("_"):
                    name = f"{node.name}.{inner.name}"
                    assert ast.get_docstring(inner), f"{name} has no docstring"


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_docstrings_name_the_real_parameters(path):
    for node in nodes(path):
        if isinstance(node, ast.FunctionDef):
            documented = _documented(ast.get_docstring(node) or "")
            arguments = node.args
            real = [a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
            real += [a.arg for a in (arguments.vararg, arguments.kwarg) if a]
            wrong = [name for name in documented if name not in real]
            assert not wrong, f"{node.name} documents {wrong}, its parameters are {real}"


def _documented(docstring):
    """The names in a numpydoc Parameters section, or before the Returns of a short docstring."""
    match = re.search(r"^Parameters\n-+\n(.*?)(?=^\S[^\n]*\n-{3,}|\Z)", docstring, re.M | re.S)
    match = match or re.search(r"(.*?)(?=^(Returns|Yields|Raises)\b|\Z)", docstring, re.M | re.S)
    names = []
    for line in match[1].splitlines():
        if line and not line.startswith(" ") and " : " in line:
            names += [name.strip(" *") for name in line.partition(" : ")[0].split(",")]
    return [name for name in names if name.isidentifier()]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_files_of_text_have_an_encoding_that_no_locale_changes(path):
    for node in nodes(path):
        if isinstance(node, ast.Call):
            given = {k.arg: k.value for k in node.keywords}
            name = getattr(node.func, "attr", getattr(node.func, "id", None))
            mode = given.get("mode", node.args[1] if len(node.args) > 1 else None)
            binary = isinstance(mode, ast.Constant) and "b" in str(mode.value)
            opens = isinstance(node.func, ast.Name) and name == "open" and not binary
            if opens or (name in ("read_text", "write_text") and _is_path(node)):
                assert "encoding" in given or None in given, f"line {node.lineno}: {name}"


def _is_path(call):
    """Whether `read_text` is a method of a path, and not our function of that name."""
    return isinstance(call.func, ast.Attribute)


@pytest.mark.parametrize("path", [*SOURCES, *TEXTS], ids=lambda p: p.relative_to(ROOT).as_posix())
def test_texts_name_no_machine(path):
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"(?<![\w.])/(work|tmp|home|root|opt)/|TODO|FIXME|XXX", text), (
        "a folder of one machine, or a mark of work to do: take it out"
    )


COMMANDS = {f"rainsim {name}": command for name, command in cli.commands.items()}
COMMANDS |= {f"python -m benchmarks {n}": command for n, command in benchmarks.commands.items()}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_documented(name):
    command = COMMANDS[name]
    assert any(re.search(rf"(`|^){name}\b", text.read_text("utf-8"), re.M) for text in TEXTS), (
        f"no page names `{name}`: add it to README.md or a page of docs/"
    )
    assert command.help and "Example:" in command.help
    for option in command.params:
        assert option.param_type_name == "argument" or option.help, option.name


def test_every_command_named_in_the_readme_exists():
    named = set(re.findall(r"^rainsim (\w+)|`rainsim (\w+)", README, flags=re.M))
    named = {one or other for one, other in named}
    assert named and named <= set(cli.commands) | {"COMMAND"}


def test_every_option_named_in_the_readme_exists():
    known = {name for c in COMMANDS.values() for p in c.params for name in p.opts}
    known |= {"--help", "--dist"}  # the latter of pytest
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", README))
    assert named and named <= known, named - known


def test_the_readme_and_ci_run_the_same_tests():
    run = (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert 'pip install -e ".[test]" && python -m pytest' in README
    assert 'python -m pip install --quiet ".[test]"' in run
    tests = "python -m pytest -q -n auto --dist worksteal"
    steps = ["ruff check .", "ruff format --check .", f"NUMBA_DISABLE_JIT=1 {tests}"]
    commands = [line.partition("  #")[0] for line in run]
    assert [line for line in commands if line in [*steps, tests]] == [
        *steps, tests,
    ]  # fmt: skip
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for step in steps:
        assert step.replace(" -q", "") in contributing, step
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    assert "ruff" in setup["options.extras_require"]["test"]


def test_presets_are_packaged_and_names_agree():
    from rainsim.config.settings import preset_names

    files = {path.stem for path in ROOT.glob("rainsim/config/presets/*.toml")}
    assert files == set(preset_names())
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    assert "presets/*.toml" in setup["options.package_data"]["rainsim.config"]
    for name in files:
        assert f"`{name}`" in (ROOT / "CHANGELOG.md").read_text() + README


def test_tests_look_outside_the_repository_in_one_place():
    paths = [p for p in ROOT.glob("tests/**/*.py") if p.name not in ("set_up.py", "test_house.py")]
    named = [p.name for p in paths if re.search(r"parents\[3\]|[\"'/]shared/", p.read_text())]
    assert not named, "use the fixture `shared`"


def test_the_shell_script_parses():
    subprocess.run(["bash", "-n", ROOT / ".ci/run"], check=True)
