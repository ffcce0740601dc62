"""The pages of the site: reachable, linked, complete; their commands are commands."""

import importlib.util
import re
from xml.etree import ElementTree

import click
import pytest

import rainsim
from benchmarks.__main__ import benchmarks
from rainsim.cli import cli
from rainsim.config.preset_files import HUMAN_KEYS, preset_names
from site_pages import DOCS, PAGES, ROOT, anchors, blocks, commands, links, name_of, sentences

PICTURES = ".png", ".jpg", ".webp", ".svg"
DRAWINGS = sorted(DOCS.glob("_static/*.svg"))
LONGEST_SENTENCE, MOST_WORDS = 30, 30_500
LARGEST_DRAWING, SMALLEST_TEXT = 12_000, 12  # bytes, px
SHOWN = [pytest.param(path, id=name_of(path)) for path in PAGES]


def module_of(name):
    """A Python file of the folder of the pages."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def from_code():
    """The module that fills the tables of the site."""
    return module_of("from_code")


def test_the_contents_name_every_page_once(from_code):
    listed = " ".join(from_code.CONTENTS.values()).split()
    there = [path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.rglob("*.md")]
    assert sorted([*listed, "index"]) == sorted(there), "list the page in docs/from_code.py"


@pytest.mark.parametrize("path", SHOWN)
def test_links_inside_lead_somewhere(path):
    for link in links(path):
        if "://" in link:
            continue
        target, _, anchor = link.partition("#")
        place = (path.parent / target).resolve() if target else path
        assert place.exists(), link
        if anchor:
            assert anchor in anchors(place), link


@pytest.mark.parametrize(
    "path", [page for page in SHOWN if not page.id.startswith("docs/developers/")]
)
def test_no_sentence_is_long(path):
    long = [one for one in sentences(path) if len(one.split()) > LONGEST_SENTENCE]
    assert not long, "cut these in two:\n" + "\n".join(long)


def test_the_book_for_users_is_short():
    pages = [path for path in DOCS.rglob("*.md") if path.parent.name != "developers"]
    words = sum(len(path.read_text(encoding="utf-8").split()) for path in pages)
    assert words <= MOST_WORDS, f"{words} words: shorten a page, or move it to docs/developers"


@pytest.mark.parametrize("path", SHOWN)
def test_places_for_the_code_are_known(path, from_code):
    for name in from_code.PLACE.findall(path.read_text(encoding="utf-8")):
        if name.startswith("include "):
            assert (ROOT / name.removeprefix("include ")).is_file()
        else:
            assert name in from_code.PARTS


def parsed(words):
    """Parse a command's words as the command line does, up to the files that must exist."""
    group, names = {"rainsim": cli, "benchmarks": benchmarks}[words[0]], list(words[1:])
    while isinstance(group, click.Group):
        assert names and names[0] in group.commands, f"no command {names[:1]}"
        group = group.commands[names.pop(0)]
    known = {name: option for option in group.params for name in option.opts}
    for word in names:
        if re.match(r"--?[a-z]", word):
            assert word.partition("=")[0] in known, f"no option {word}"
    try:
        group.make_context(words[-1], names, resilient_parsing=False)
    except click.exceptions.Exit:
        pass
    except click.UsageError as error:
        assert "does not exist" in error.message, error.message


@pytest.mark.parametrize("path", SHOWN)
def test_commands_can_be_typed(path):
    for block in blocks(path):
        for command in commands(block):
            parsed(command.words)


def test_a_wrong_command_is_found():
    parsed(["rainsim", "run", "--frames", "3"])
    parsed(["benchmarks", "water", "--quick"])
    wrong = "rainsim rain", "rainsim run --raine 3", "rainsim run --frames three"
    for words in (*wrong, "rainsim water", "benchmarks run", "benchmarks water --slow"):
        with pytest.raises(AssertionError):
            parsed(words.split())


def test_every_command_and_option_is_documented(from_code):
    page, options = from_code.filled("<!-- code: commands -->"), 0
    for name, command in from_code.commands():
        assert f"## {name}\n" in page
        for option in command.params:
            if option.param_type_name == "option":
                assert option.help and f"`{option.opts[0]}`" in page, (name, option.opts)
                options += 1
    assert options > 200
    plain = re.sub(r"^```.*?^```", "", page, flags=re.M | re.S)
    assert not re.search(r"^ {4}|\x08|Example:", plain, re.M)  # text, no code by indentation


def test_every_key_variable_and_name_is_documented(from_code):
    assert re.findall(r"^\| `(\w+)`", from_code.keys(), re.M) == list(HUMAN_KEYS)
    assert re.findall(r"^\| `(\w+)`", from_code.variables(), re.M) == list(from_code.VARIABLES)
    assert re.findall(r"^\| (\d+) ", from_code.exit_codes(), re.M) == ["0", "1", "2", "130"]
    assert re.findall(r"^### (\w+)", from_code.presets(), re.M) == preset_names()
    named = re.findall(r"^### rainsim\.(\w+)", from_code.names(), re.M)
    assert sorted(named) == sorted(set(rainsim.__all__) - {"__version__"})
    assert "| 1 |" in from_code.formats() and "paving" in from_code.classes()


def test_all_that_exists_is_documented(from_code):
    rows = re.findall(r"^\| ([^|]+) \| (\d+) \| (\d+) \|$", from_code.counts(), re.M)
    there = {what: int(exist) for what, _, exist in rows}
    assert len(there) == 9 and all(documented == exist for _, documented, exist in rows), rows
    assert there["options"] > 200 and there["keys of preset files"] == len(HUMAN_KEYS)
    assert there["functions and methods without a leading underscore"] > 1000


def test_every_variable_of_ours_that_the_code_reads_is_documented(from_code):
    text = "".join(path.read_text(encoding="utf-8") for path in ROOT.glob("rainsim/**/*.py"))
    used = set(re.findall(r"\"(RAINSIM_[A-Z_]+)\"", text))
    assert used and used <= set(from_code.VARIABLES)
    for name in from_code.VARIABLES:
        assert name.startswith(("NUMBA_CPU", "NUMBA_NUM")) or f'"{name}"' in text, name


def test_pictures_of_pages_are_there_and_used():
    used = {(path.parent / link).resolve() for path in PAGES for link in links(path)}
    pictures = {path for path in DOCS.rglob("*") if path.suffix in PICTURES}
    assert pictures <= used, sorted(name_of(path) for path in pictures - used)


@pytest.mark.parametrize("path", SHOWN)
def test_every_picture_stands_near_its_command(path):
    text = path.read_text(encoding="utf-8")
    for match in re.finditer(r"!\[[^\]]*\]\(([^)]+)\)", text):
        if match[1].endswith(".svg"):
            continue  # drawn by hand: no command makes it
        near = text[max(0, match.start() - 1200) : match.end() + 700]
        by = r"rainsim (run|view|heightmap|export) |rainsim view|python -m benchmarks "
        by += r"|python examples/"
        assert re.search(rf"{by}|gallery\.md", near), match[1]


@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem) for path in DRAWINGS])
def test_drawings_are_small_and_name_what_exists(path, from_code):
    text = path.read_text(encoding="utf-8")
    assert len(text.encode()) < LARGEST_DRAWING
    root = ElementTree.fromstring(text)
    assert root.get("width") == "760" and root.find("{*}title").text
    assert "href" not in text and "<script" not in text
    sizes = [float(size) for size in re.findall(r"font-size:\s*([\d.]+)px", text)]
    assert sizes and min(sizes) >= SMALLEST_TEXT
    words = " ".join(root.itertext())
    params = [param for _, command in from_code.commands() for param in command.params]
    options = {name for param in params for name in param.opts}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", words)) <= options
    files = {file.name for file in ROOT.glob("rainsim/**/*.py")}
    assert set(re.findall(r"\w+\.py\b", words)) <= files
    assert set(re.findall(r"\brainsim (\w+)", words)) <= set(cli.commands)


def test_maps_show_the_code_as_it_is():
    """After a change of rooms or passes: `python docs/drawings.py`."""
    maps = module_of("drawings")
    for name, draw in maps.DRAWINGS.items():
        assert (maps.FOLDER / f"{name}.svg").read_text(encoding="utf-8") == draw(), (
            f"{name} is out of date: run `python docs/drawings.py`"
        )
    assert len(maps.order()) > 25


def test_the_version_stands_in_the_citation():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {rainsim.__version__}\n" in text
