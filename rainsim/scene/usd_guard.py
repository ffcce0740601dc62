"""What a USD file may make its library do: which files it opens, how deep and how large it is.

The library follows every name in a file, devices and pipes too, nests as deep as its stack lasts,
and composes references of references into any number of prims. All of it is looked at first.
"""

from __future__ import annotations

import re
import zipfile
from contextlib import contextmanager
from pathlib import Path

from rainsim.errors import InputError, RainsimError
from rainsim.io.files import require_file

MOST_FILES, MOST_BYTES = 10_000, 1 << 32  # of a stage in all; a film's shot has some hundred MB
MOST_TEXT = 1 << 28  # bytes of one file that is text
MOST_DEPTH = 200  # prims or brackets within each other; stages of films have some 20
MOST_PRIMS = 300_000  # some 700 MB
CAMERA_ALONE = "export the camera alone"
TYPED = ("xformOp", "focalLength", "horizontalAperture", "verticalAperture")  # as names begin
TEXT, ZIP = b"#", b"PK\x03\x04"  # as files begin; others are binary
STEPS = {b"[": 1, b"(": 1, b"{": 1, b"]": -1, b")": -1, b"}": -1}
# Text within quotes, asset names and comments hold no brackets that count. What is not closed goes
# on to the end, so that no part is looked at twice.
TOKENS = re.compile(
    rb'"""(?:[^"\\]|\\.|"(?!""))*(?:""")?|"(?:[^"\\\n]|\\.)*"?'
    rb"|'''(?:[^'\\]|\\.|'(?!''))*(?:''')?|'(?:[^'\\\n]|\\.)*'?"
    rb"|//[^\n]*|/\*.*?(?:\*/|\Z)|@@@.*?(?:@@@|\Z)|@[^@\n]*@?|#[^\n]*|[][(){}]",
    re.DOTALL,
)


@contextmanager
def opened(path):
    """Yield the stage at `path`, checked, and the bytes of all of its files.

    Whatever the library cannot use of it while it is open is said in one line, its warnings not.
    """
    from pxr import Usd, UsdUtils

    quiet = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        root, files = require_tame(path)
        yield Usd.Stage.Open(root), sum(file.stat().st_size for file in files)
    except (RainsimError, OSError):
        raise
    except Exception as error:  # the library's own, and those of values of other types
        raise InputError(
            f"{path} cannot be read as USD ({reason(error)}); its values must be of USD's types "
            "and its files whole; export it again"
        ) from None
    finally:
        del quiet


def require_types(path, prim):
    """Raise InputError if lens or place of a prim have values of other types than USD gives them.

    The library takes defaults for most of them without a word. Parents place a prim too.
    """
    from pxr import Gf, Usd

    while prim:
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if not name.startswith(TYPED):
                continue
            value = attribute.Get(Usd.TimeCode.EarliestTime())
            wanted = (type(attribute.GetTypeName().defaultValue),)
            if name.startswith("xformOp:orient"):
                wanted = Gf.Quatf, Gf.Quatd, Gf.Quath
            if value is not None and type(value) not in wanted:
                raise InputError(
                    f"{path} {prim.GetPath()}: {name} is a {type(value).__name__}; it must be a "
                    f"{wanted[0].__name__}; correct it, or export it again"
                )
        prim = prim.GetParent()


def reason(error):
    """Return why the library failed, as its exception has it."""
    try:
        found = re.search(r" : '(.*)'", str(error))
    except UnicodeDecodeError:  # it quotes a file whose bytes are no text
        return "bytes that are no text"
    return found[1] if found else type(error).__name__


def require_tame(path):
    """Raise InputError unless the stage at `path` names regular files only and stays within bounds.

    Returns the stage's root layer, opened, and its files, a list of Path.
    """
    from pxr import Ar, Sdf, Tf

    root, files, size = None, {}, 0
    todo = [str(path)]
    while todo:
        name = todo.pop()
        file = Ar.SplitPackageRelativePathOuter(name)[0]
        if name in files:
            continue
        files[name] = Path(file)
        size += checked_size(path, file)
        if len(files) > MOST_FILES or size > MOST_BYTES:
            raise InputError(
                f"{path} needs more than {MOST_FILES} files or {MOST_BYTES} bytes; {CAMERA_ALONE}"
            )
        try:
            layer = Sdf.Layer.FindOrOpen(name)
        except Tf.ErrorException:
            if root is None:
                raise
            continue  # the library leaves out what it cannot read
        if layer is None:
            continue
        root = root or layer
        _check_specs(path, layer)
        for asset in filter(None, layer.GetCompositionAssetDependencies()):
            if asset.startswith("`"):
                raise InputError(f"{path} computes names of files ({asset}); {CAMERA_ALONE}")
            found = Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
            if Ar.GetResolver().Resolve(found):  # what is not there the library leaves out
                todo.append(found)
    if root is None:
        raise InputError(f"{path} cannot be opened as USD; export it again")
    _check_composed(path, root)
    return root, list(dict.fromkeys(files.values()))


def checked_size(path, file):
    """Return the bytes of a regular file, checked for brackets that are nested without end.

    `path` is the stage that names it.
    """
    size = require_file(file, "each file that a USD stage names").stat().st_size
    with open(file, "rb") as opened:
        start = opened.read(len(ZIP))
    if start == ZIP:
        _check_package(path, file, size)
    elif start.startswith(TEXT):
        with open(file, "rb") as opened:
            _check_text(path, file, size, opened.read(MOST_TEXT))
    return size


def _check_package(path, file, size):
    """Check the texts in a .usdz, whose members lie in it as they are."""
    try:
        with zipfile.ZipFile(file) as archive:
            for info in archive.infolist():
                if info.compress_type != zipfile.ZIP_STORED or info.file_size > size:
                    raise InputError(f"{file} is packed; a .usdz must not be; {CAMERA_ALONE}")
                with archive.open(info) as member:
                    if member.read(len(TEXT)) == TEXT:
                        _check_text(path, file, info.file_size, TEXT + member.read(MOST_TEXT))
    except (zipfile.BadZipFile, NotImplementedError, OSError, RuntimeError):
        raise InputError(f"{file} cannot be opened as .usdz; export it again") from None


def _check_text(path, file, size, text):
    """Raise InputError if a text of `size` bytes in a file is too long or nested too deep."""
    if size > MOST_TEXT:
        raise InputError(f"{file} has {size} bytes of text, beyond {MOST_TEXT}; {CAMERA_ALONE}")
    depth = 0
    for token in TOKENS.finditer(text):
        depth += STEPS.get(token[0], 0)
        if depth > MOST_DEPTH:
            raise _too_deep(path)


def _check_specs(path, layer):
    """Raise InputError if a layer as it is stored is too deep, too large or has value clips."""
    todo, count = [layer.pseudoRoot], 0
    while todo:
        spec = todo.pop()
        count += 1
        if spec.path.pathElementCount > MOST_DEPTH:
            raise _too_deep(path)
        if count > MOST_PRIMS:
            raise _too_many(path)
        if spec.HasInfo("clips"):
            raise InputError(f"{path} has value clips, which name more files; {CAMERA_ALONE}")
        todo += list(spec.nameChildren)
        if spec != layer.pseudoRoot:
            for kinds in spec.variantSets.values():
                todo += [variant.primSpec for variant in kinds.variants.values()]


def _check_composed(path, root):
    """Raise InputError if references make too deep or too many prims of a stage."""
    from pxr import Pcp, Sdf

    cache = Pcp.Cache(Pcp.LayerStackIdentifier(root), "usd", True)
    todo, count = [Sdf.Path.absoluteRootPath], 0
    while todo:
        prim = todo.pop()
        count += 1
        if prim.pathElementCount > MOST_DEPTH:
            raise _too_deep(path)
        if count > MOST_PRIMS:
            raise _too_many(path)
        index, _ = cache.ComputePrimIndex(prim)
        children = [prim.AppendChild(name) for name in index.ComputePrimChildNames()[0]]
        cache.RequestPayloads(children, [])
        todo += children


def _too_deep(path):
    return InputError(f"{path} nests more than {MOST_DEPTH} levels deep; {CAMERA_ALONE}")


def _too_many(path):
    return InputError(f"{path} has more than {MOST_PRIMS} prims; {CAMERA_ALONE}")
