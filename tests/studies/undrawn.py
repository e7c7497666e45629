"""The command without the figures of its pages, which take longer than small runs.

Use: ``python -m tests.studies.undrawn run STUDY …`` in the folder of the repository.
"""

if __name__ == "__main__":  # Worker processes also load this module
    import sys

    from tests.report.figures import leave_out_figures

    from mcspectra.cli.main import main

    leave_out_figures(setattr)
    sys.exit(main())
