"""The command with a small first example of the explorer, and with coarse integrals of pixels.

Use: ``python -m tests.app.small app --no-browser`` in the folder of the repository.
"""

if __name__ == "__main__":
    import sys

    from mcspectra.app import page
    from mcspectra.cli.main import main
    from mcspectra.rendering import pixel

    # One round instead of four, for each tab that shows the example
    title, query = next(iter(page._EXAMPLES.items()))
    page._EXAMPLES[title] = f"{query}&realizations=16&b.realizations=16"
    pixel._POINTS = 2**10
    sys.exit(main())
