"""`python -m coaxlink` is the `coaxlink` command."""

from coaxlink.cli import main

if __name__ == "__main__":
    main()
