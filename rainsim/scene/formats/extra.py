"""The optional reader of compressed formats (gsply): how it is imported and its errors caught.

Its decoders are compiled without bounds checks and trust their input. So the readers check a file
first, down to the size of every array that a decoder indexes. Any error that a decoder still raises
becomes one line.
"""

from contextlib import contextmanager
from importlib import import_module

from rainsim.errors import InputError
from rainsim.scene.activate import activate

INSTALL = 'pip install "rainsim[formats]"'


def load_extra(path, kind, *modules):
    """Return gsply after importing the `modules` that read `path`; InputError if one is missing."""
    import rainsim.jit  # noqa: F401  (its compiled kernels belong into our cache folder)

    for module in (*modules, "gsply"):
        try:
            found = import_module(module)
        except ImportError:
            raise InputError(
                f"{path} is {kind}; reading it needs the package {module}; {INSTALL}"
            ) from None
    return found


def activated(data):
    """Return the Splats of what gsply has decoded, and which are usable (n,)."""
    rest = data.shN if data.shN is not None and data.shN.shape[1] else None
    return activate(data.means, data.scales, data.quats, data.opacities.ravel(), data.sh0, rest)


@contextmanager
def decoding(path, kind):
    """Turn whatever a third-party decoder raises into one InputError about `path`."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # whatever a damaged file does to a decoder: never a traceback
        raise InputError(
            f"{path} cannot be decoded as {kind} ({type(error).__name__}); it must be whole and "
            "undamaged; export it again"
        ) from None
