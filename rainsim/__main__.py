"""Entry of `python -m rainsim`, the command line."""

from rainsim.cli import main

if __name__ == "__main__":
    main()
