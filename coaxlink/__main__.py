"""`python -m coaxlink` is the `coaxlink` command."""

from coaxlink._start import main

if __name__ == "__main__":
    main()
