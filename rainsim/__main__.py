"""Entry of `rainsim` and of `python -m rainsim`, the command line."""

import sys


def main():
    """Run the command line; Ctrl-C while it is read is one line as it is later on."""
    try:
        from rainsim.cli import main as run

        run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
