"""Run all or the named benchmarks: ``python -m benchmarks spectrum start``, ``cost --plot``."""

import importlib
import sys

NAMES = (
    "spectrum",
    "streams",
    "samplers",
    "start",
    "stores",
    "oracles",
    "identity",
    "veach",
    "pixel",
    "figure1",
    "bases",
    "pairs",
    "convergence",
    "coverage",
    "peers",
    "periodized",
    "predictions",
    "closed_forms",
    "agreement",
    "battery",
    "settings",
    "improvements",
    "contribution",
    "listed",
    "cost",
    "large",
    "maps",
    "paths",
    "plugin",
    "scenes",
    "production",
    "images",
    "masks",
    "gate",
    "blender",
    "filters",
    "findings",
    "studies",
    "scaling",
    "app",
    "design",
    "learned",
    "descent",
)


def main() -> int:
    """Print the lines of each benchmark; unknown names are an error."""
    if "--help" in sys.argv or "-h" in sys.argv:
        print(f"{__doc__}\n\n{', '.join(NAMES)}")
        return 0
    flags = [argument for argument in sys.argv[1:] if argument.startswith("--")]
    chosen = [argument for argument in sys.argv[1:] if argument not in flags] or NAMES
    for name in (each.replace("-", "_") for each in chosen):
        if name not in NAMES:
            print(
                f"There is no benchmark {name!r}; give names among {', '.join(NAMES)}.",
                file=sys.stderr,
            )
            return 2
        print(f"## {name}")
        importlib.import_module(f"benchmarks.{name}").main(*flags)
    return 0


if __name__ == "__main__":
    sys.exit(main())
