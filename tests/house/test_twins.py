"""A CUDA twin stands at the path of what it is a twin of."""

from source import PACKAGE, arguments_of, functions_in, is_compiled

# Files that only the device needs, each with its reason.
CUDA_ONLY = {
    "driver.py",  # copies between host and device
    "frame_uniforms.py",  # numbers of a frame, sent in one copy
    "launch.py",  # launches by the driver
    "moving_map.py",  # windows of a map that are sent
    "kernel_cache.py",  # machine code on disk, by numba-cuda's classes
    "rain/drip_list.py",  # drips in the air, which the CPU keeps in one array
    "render/device_tables.py",  # maps and numbers that the passes read
    "splatting/sort.py",  # the sort of all tiles' entries at once
    "scalars.py",  # sums and lists over a grid of threads
    "warp.py",  # instructions of a warp
    "water/flow.py",  # the step of the water in one launch, for which the CPU has two files
}


def test_each_file_of_cuda_has_a_file_of_the_cpu_at_its_path():
    cuda = PACKAGE / "cuda"
    names = {path.relative_to(cuda).as_posix() for path in cuda.rglob("*.py")}
    alone = {name for name in names if not (PACKAGE / name).exists()}
    assert alone == CUDA_ONLY, "move a twin to its CPU file's path; list other files in CUDA_ONLY"
    assert len(names - alone) > 15


def test_formulas_have_no_second_body_under_cuda():
    """A scalar function of the CPU is called by the twin, not written again under its name."""
    cuda = PACKAGE / "cuda"
    for path in cuda.rglob("*.py"):
        other = PACKAGE / path.relative_to(cuda)
        if other.exists() and path.name != "jit.py":
            ours = {name for name, f in functions_in(other) if is_formula(f)}
            again = {name for name, f in functions_in(path) if is_compiled(f)} & ours
            assert not again, f"{path.relative_to(PACKAGE)}: {again}"


def is_formula(function):
    """Tell whether kernels of both backends can call a function, which writes to no array."""
    marks = {getattr(d, "id", getattr(d, "attr", None)) for d in function.decorator_list}
    writes = any(name.endswith("_out") for name in arguments_of(function))
    formulas = {"device_function", "lean_function", "inlined_function", "called_function"}
    return bool(marks & formulas) and not writes
