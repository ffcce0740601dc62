"""`python -m rainsim`."""

from rainsim.cli import main

if __name__ == "__main__":
    main()
