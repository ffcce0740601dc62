"""What rainsim runs on here, and what is wrong with it: `rainsim doctor`."""

import os
import platform
import shutil

import numpy as np

from rainsim import __version__
from rainsim.compiling import shipped
from rainsim.compiling.folder import LOST, NAME, REFUSED
from rainsim.compiling.pool import cores
from rainsim.compiling.start import not_shipped
from rainsim.io import cache as results
from rainsim.io.fingerprint import versions
from rainsim.jit import CACHE_FOLDER, cpu_kernel, prange, processor, threading_layer

PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "numba-cuda", "cuda-cccl")
OPTIONAL = {
    "gsply": "formats", "imagecodecs": "formats", "imageio-ffmpeg": "video", "matplotlib": "chart",
}  # fmt: skip
LEAST_MEMORY = 4e9  # bytes; a scene of some hundred thousand splats and its map
LEAST_CACHE = 300e6  # bytes for compiled kernels


@cpu_kernel
def _use_threads(out):
    for i in prange(len(out)):
        out[i] = i


def report():
    """Return the facts by subject, and under "wrong" a list of lines, each with its remedy."""
    wrong = []
    _use_threads(np.empty(64))
    layer, threads = threading_layer()
    if threads == 1 < cores():
        wrong.append(f"one thread of {cores()} cores is used; unset NUMBA_NUM_THREADS or raise it")
    memory = _memory()
    if memory["total"] and memory["total"] < LEAST_MEMORY:
        wrong.append(
            f"{memory['total'] / 1e9:.1f} GB of memory; large captures need {LEAST_MEMORY / 1e9:g}"
        )
    cache = _cache()
    if not cache["writable"]:
        wrong.append(f"{cache['folder']} cannot be written; set NUMBA_CACHE_DIR to a folder")
    elif cache["free"] < LEAST_CACHE:
        wrong.append(
            f"{cache['free'] / 1e6:.0f} MB are free for compiled kernels in {cache['folder']}; "
            "make room or set NUMBA_CACHE_DIR"
        )
    elif not cache["kept"]:
        wrong.append(
            f"compiled kernels go to {cache['folder']} and are lost; set NUMBA_CACHE_DIR to a "
            "folder that can be written"
        )
    wrong += cache["refused"]
    kernels = _shipped()
    if kernels["damaged"]:
        count, first = len(kernels["damaged"]), kernels["damaged"][0]
        wrong.append(
            f"{count} file{' is' if count == 1 else 's are'} damaged in {shipped.DISTRIBUTION} "
            f"({first}): what they hold is compiled here; install it again"
        )
    return {
        "versions": {"rainsim": __version__, **versions((*PACKAGES, *OPTIONAL))},
        "threads": {"number": threads, "cores": cores(), "layer": layer},
        "backends": {"cpu": {"ready": True, "name": _processor()}, "cuda": _cuda()},
        "memory": memory, "cache": cache, "kernels": kernels, "results": results.summary(),
        "wrong": wrong,
    }  # fmt: skip


def _processor():
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _memory():
    """Return all and free memory in bytes; None where the system does not say."""
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        return {
            "total": page * os.sysconf("SC_PHYS_PAGES"),
            "free": page * os.sysconf("SC_AVPHYS_PAGES"),
        }
    except (ValueError, OSError, AttributeError):
        return {"total": None, "free": None}


def _cache():
    size = sum(file.stat().st_size for file in CACHE_FOLDER.rglob("*") if file.is_file())
    return {
        "folder": str(CACHE_FOLDER), "writable": os.access(CACHE_FOLDER, os.W_OK), "size": size,
        "free": shutil.disk_usage(CACHE_FOLDER).free,
        "kept": CACHE_FOLDER.name == NAME and not CACHE_FOLDER.parent.name.startswith(LOST),
        "refused": REFUSED,
    }  # fmt: skip


def _shipped():
    """Return whether shipped kernels are used or why not, and which of them are not."""
    used = shipped.PACK is not None
    return {
        "used": used, "why": shipped.FAULT, "processor": processor(),
        "damaged": shipped.PACK.damaged() if used else [],
        "changed": [entry.kernel for entry in not_shipped()] if used else [],
    }  # fmt: skip


def _cuda():
    """Return what the CUDA backend runs on, or why it does not."""
    from rainsim import cuda

    trouble = cuda.trouble()
    if trouble is not None:
        return {"ready": False, "why": trouble}
    return {"ready": True, **cuda.device()}


def table(found):
    """Return a report as lines of text."""
    present = {k: v for k, v in found["versions"].items() if v and k not in OPTIONAL}
    lines = ["versions   " + ", ".join(f"{k} {v}" for k, v in present.items())]
    extras = ", ".join(
        f"{name} " + (found["versions"][name] or f'missing: pip install "rainsim[{extra}]"')
        for name, extra in OPTIONAL.items()
    )
    threads, memory, cache = found["threads"], found["memory"], found["cache"]
    lines += [
        f"extras     {extras}",
        f"threads    {threads['number']} of {threads['cores']} cores, layer {threads['layer']}",
        f"cpu        ready: {found['backends']['cpu']['name']}",
    ]
    gpu = found["backends"]["cuda"]
    if gpu["ready"]:
        lines.append(
            f"cuda       ready: {gpu['name']}, compute capability {gpu['capability']}, "
            f"{gpu['free'] / 1e9:.1f} of {gpu['total'] / 1e9:.1f} GB free"
        )
    else:
        lines.append(f"cuda       not ready: {gpu['why']}")
    if memory["total"]:
        lines.append(
            f"memory     {memory['free'] / 1e9:.1f} of {memory['total'] / 1e9:.1f} GB free"
        )
    lines.append(f"cache      {cache['folder']}: {cache['size'] / 1e6:.0f} MB of compiled kernels")
    lines.append(f"kernels    {_kernels_line(found['kernels'])}")
    lines.append(_results_line(found["results"]))
    lines += [f"WRONG      {line}" for line in found["wrong"]] or ["nothing is wrong"]
    return "\n".join(lines)


def _kernels_line(kernels):
    """Return a text on the package of shipped kernels and what is compiled here beside them."""
    name, level = shipped.DISTRIBUTION, shipped.PROCESSOR["NUMBA_CPU_NAME"]
    if not kernels["used"]:
        why = kernels["why"] or f"not installed, or {shipped.VARIABLE} is {shipped.OFF}"
        return f"compiled here; {name} is not used: {why}"
    here = list(dict.fromkeys(kernels["changed"]))
    if not here:
        return f"loaded from {name}, for {level}"
    return (
        f"loaded from {name}, for {level}, but for {len(here)} that are compiled here: their "
        f"sources are not those it was made from, or a file is damaged ({', '.join(here[:3])}"
        f"{', ...' if len(here) > 3 else ''})"
    )


def _results_line(kept):
    """Return the line of the table on the results of earlier runs."""
    if kept["folder"] is None:
        return f"results    not kept: {results.VARIABLE} is {results.OFF}"
    size = f"{kept['size'] / 1e6:.0f} MB in {kept['entries']} kept scenes, frames and height maps"
    cannot = "" if kept["writable"] else "; the folder cannot be written, so none is added"
    return f"results    {kept['folder']}: {size}{cannot}"
