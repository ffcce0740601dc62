"""Set up for the tests of the package and of the benchmarks."""

pytest_plugins = ["set_up"]  # tests/set_up.py
