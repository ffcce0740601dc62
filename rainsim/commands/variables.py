"""The environment variables that rainsim reads, for the reference; a test compares with the code.

Those that begin with NUMBA, XDG or CUDA belong to other programs, and mean what they mean
there.
"""

VARIABLES = {
    "RAINSIM_SCENES": "folders with scenes that are known by name, separated as in PATH",
    "RAINSIM_CACHE": "folder of kept results (built-in scenes, ground frames, height maps), or off "
    "to keep nothing; default: rainsim/results in the user's cache folder",
    "RAINSIM_COMPILE_PROCESSES": "number of processes that compile kernels; 1 compiles in the "
    "command itself; default: one for each core and 700 MB of free memory",
    "RAINSIM_KERNELS": "off leaves the package rainsim-kernels unused: all kernels are compiled "
    "here, for the processor of this machine",
    "RAINSIM_CUDA_CAPABILITY": "compute capability, such as 9.0, that a process compiles for "
    "without a GPU; rainsim sets it for those that compile",
    "NUMBA_CACHE_DIR": "folder of compiled kernels; default: the user's cache folder",
    "NUMBA_NUM_THREADS": "most threads; --threads takes some of them",
    "NUMBA_CPU_NAME": "processor that kernels are compiled for; x86-64-v3, with "
    "NUMBA_CPU_FEATURES empty, gives the same bytes on processors of several kinds",
    "NUMBA_CPU_FEATURES": "instructions beyond those of NUMBA_CPU_NAME, as LLVM names them; empty: "
    "none; default: those of this processor",
    "NUMBA_DISABLE_JIT": "1 runs the formulas as plain Python, for tests of them",
    "NUMBA_ENABLE_CUDASIM": "1 runs the GPU's kernels in numba's simulator, for tests of them",
    "CUDA_VISIBLE_DEVICES": "GPUs that --backend cuda may use; --workers deals them out in turn",
    "XDG_CACHE_HOME": "the user's cache folder; default: ~/.cache",
    "XDG_DATA_HOME": "the user's data folder, in whose rainsim/scenes scenes are found by name",
}
