"""Counter-based random numbers: a value is a hash of its key, not the next one of a sequence.

The key of a value is a chain of integers (seed, class, cube, drop, ...). So any drop of any frame
can be made alone, in any order, on any number of threads.

References
----------
The finaliser is that of SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number
generators", OOPSLA 2014) with Stafford's "mix 13" multipliers; unlike SplitMix64 the counter is
given, not stepped.
"""

import numpy as np

from rainsim.jit import device_function

_STEP = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio: spreads consecutive counters
_MULTIPLY_1 = np.uint64(0xBF58476D1CE4E5B9)
_MULTIPLY_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_30, _SHIFT_27, _SHIFT_31 = np.uint64(30), np.uint64(27), np.uint64(31)

_SHIFT_11, _SHIFT_22, _SHIFT_43 = np.uint64(11), np.uint64(22), np.uint64(43)
_MASK_21 = np.uint64(2**21 - 1)
_UNIT_53 = 2.0**-53
_UNIT_21 = 2.0**-21
_HALF = 0.5
_TAIL = 1e-15  # of a Poisson distribution, below the resolution of its 53-bit number


@device_function
def mix(word):
    """Scramble the uint64 `word`: a bijection whose output bits all depend on all input bits."""
    word = (word ^ (word >> _SHIFT_30)) * _MULTIPLY_1
    word = (word ^ (word >> _SHIFT_27)) * _MULTIPLY_2
    return word ^ (word >> _SHIFT_31)


@device_function
def subkey(key, item):
    """Return the uint64 key of child `item` (an int64 of any sign) of the uint64 `key`."""
    return mix(key + _STEP * np.uint64(np.int64(item)))


@device_function
def uniform(word):
    """Return a float64 in [0, 1) from all but the lowest 11 bits of a uint64."""
    return np.int64(word >> _SHIFT_11) * _UNIT_53


@device_function
def uniform_triple(word):
    """Return three float64 in (0, 1) of 21 bits each from one uint64."""
    return (
        (np.int64(word & _MASK_21) + _HALF) * _UNIT_21,
        (np.int64((word >> _SHIFT_22) & _MASK_21) + _HALF) * _UNIT_21,
        (np.int64(word >> _SHIFT_43) + _HALF) * _UNIT_21,
    )


def poisson_tables(mean):
    """Return cumulative Poisson distributions, one row per mean; rows end with 2, beyond any u."""
    width = int(mean.max() + 9 * np.sqrt(mean.max()) + 24)
    number = np.arange(width)
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(number[1:]))])
    log_mean = np.log(np.maximum(mean, np.finfo(np.float64).tiny))[:, None]
    table = np.cumsum(np.exp(number * log_mean - mean[:, None] - log_factorial), axis=1)
    table[table > 1 - _TAIL] = 2.0
    table[:, -1] = 2.0
    return table
