"""What a USD file may make its library do: which files it opens, how deep and how large it is.

The library follows every name in a file, devices and pipes too, nests as deep as its stack lasts,
composes references of references into any number of prims, and takes memory for whatever counts a
damaged file has. So names and prims are looked at first, in a process of its own that may end.
"""

import os
import pickle
import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from rainsim.compiling.pool import child_environment
from rainsim.errors import InputError, RainsimError
from rainsim.io.files import require_file

MOST_FILES, MOST_BYTES = 10_000, 1 << 32  # of a stage in all; a film's shot has some hundred MB
MOST_DEPTH = 200  # prims within each other; stages of films have some 20
MOST_PRIMS, PRIM_BYTES = 300_000, 3_000  # of a stage with all references; of memory for each
FREE_BYTES, TIMES = 200_000_000, 16  # of memory; times the size of files that is taken beyond
PATIENCE, SPEED = 60.0, 1e6  # s for a small stage; bytes/s of a large one
CAMERA_ALONE = "export the camera alone"
TYPED = ("xformOp", "focalLength", "horizontalAperture", "verticalAperture")  # as names begin
CHILD = "from rainsim.scene.usd_guard import serve; serve()"
_start = None  # bytes of this process before it reads, where it may take no more than it should


def apart(function, path, *given):
    """Return `function(path, *given)`, called in a process of its own, bounded in memory and time.

    InputError where that process does not come back: the library has run out of stack or bounds.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", CHILD], input=pickle.dumps((function, path, given)),
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            timeout=PATIENCE + require_file(path, "a USD file").stat().st_size / SPEED,
            env=child_environment() | {"PXR_WORK_THREAD_LIMIT": "1"},
        )  # fmt: skip
        found = pickle.loads(done.stdout) if done.returncode == 0 else None
    except subprocess.TimeoutExpired:
        found = None
    if found is None:
        raise InputError(
            f"{path} cannot be read as USD: OpenUSD breaks off, or takes too much memory or time; "
            f"it must be whole and nest at most {MOST_DEPTH} levels; export it again"
        )
    if isinstance(found, Exception):
        raise found
    return found


def serve():
    """Do in the process that `apart` has started what it was started for."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the library prints is no answer
    function, *given = pickle.load(sys.stdin.buffer)
    watch_memory()
    try:
        found = function(given[0], *given[1])
    except (RainsimError, OSError) as error:
        found = error
    pickle.dump(found, out, 5)
    out.close()


def watch_memory():
    """Let this process take memory in proportion to the files that it opens, where Linux has it."""
    global _start
    from pxr import Gf, Pcp, Sdf, Usd, UsdGeom, UsdRender, UsdVol, Vt  # noqa: F401  (it counts)

    stage = Usd.Stage.CreateInMemory()
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    camera.GetCamera(Usd.TimeCode.Default())  # which takes 400 MB of addresses, once
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[0]
        _start = int(pages) * os.sysconf("SC_PAGESIZE")
    except OSError:
        return


def _allow(size, prims):
    if _start is not None:
        import resource

        limit = _start + FREE_BYTES + TIMES * size + PRIM_BYTES * prims
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


@contextmanager
def opened(path):
    """Yield the stage at `path`, checked, and the bytes of all of its files.

    Whatever the library cannot use of it while it is open is said in one line.
    """
    from pxr import Usd

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
        size += require_file(file, "each file that a USD stage names").stat().st_size
        if len(files) > MOST_FILES or size > MOST_BYTES:
            raise InputError(
                f"{path} needs more than {MOST_FILES} files or {MOST_BYTES} bytes; {CAMERA_ALONE}"
            )
        _allow(size, 0)
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
    _check_composed(path, root, size)
    return root, list(dict.fromkeys(files.values()))


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


def _check_composed(path, root, size):
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
        if count % 1000 == 1:
            _allow(size, count + 1000)
        index, _ = cache.ComputePrimIndex(prim)
        children = [prim.AppendChild(name) for name in index.ComputePrimChildNames()[0]]
        cache.RequestPayloads(children, [])
        todo += children


def _too_deep(path):
    return InputError(f"{path} nests more than {MOST_DEPTH} levels deep; {CAMERA_ALONE}")


def _too_many(path):
    return InputError(f"{path} has more than {MOST_PRIMS} prims; {CAMERA_ALONE}")
