"""A process that compiles kernels for another one: `python -m rainsim.compiling.worker`.

It reads a line of JSON for each kernel from its standard input, `{"kernel": "module:name",
"arguments": ["float32[::1], int64", ...]}`, and answers each with a line `{"compiled": 1,
"seconds": 2.5, "stale": []}`. It ends when its input does.
"""

import gc
import importlib
import json
import os
import signal
import sys
import time


def compile_kernel(kernel, arguments):
    """Compile a kernel for lists of arguments; return count, seconds, and why others are stale."""
    from rainsim.compiling.signatures import from_text, split
    from rainsim.jit import KERNELS, held

    try:
        importlib.import_module(kernel.partition(":")[0])
        function = KERNELS[kernel]
    except (ImportError, KeyError) as error:
        return 0, 0.0, [f"{kernel}: {type(error).__name__}: {error}"]
    compiled, stale = 0, []
    begin = time.thread_time()
    for texts in arguments:
        try:
            signature = tuple(from_text(text) for text in split(texts))
            if not held(function, signature):
                function.compile(signature)
                compiled += 1
        except Exception as error:  # numba raises many kinds for arguments that do not fit
            reason = str(error).strip().partition("\n")[0]
            stale.append(f"{kernel}: {type(error).__name__}: {reason}")
    return compiled, time.thread_time() - begin, stale


def main():
    """Answer lines of standard input until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that asked ends this one
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is no answer
    gc.disable()  # looking for cycles costs 4 % of the time, what is in them 11 MB a kernel
    for line in sys.stdin:
        job = json.loads(line)
        compiled, seconds, stale = compile_kernel(job["kernel"], job["arguments"])
        answer = {"compiled": compiled, "seconds": round(seconds, 3), "stale": stale}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
