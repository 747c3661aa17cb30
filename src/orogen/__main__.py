"""`python -m orogen` is the `orogen` command."""

from orogen.cli import main

if __name__ == "__main__":
    main()
