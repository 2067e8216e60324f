"""`python -m tests.language`: print the findings; exit code 1 if there is one outside of the exceptions.

`--all` prints those of the exceptions, too; further arguments keep the paths that begin with one of them.
`--exceptions` prints the entries that `EXCEPTIONS` needs at present.
"""

from __future__ import annotations

import sys

from tests.language.check import EXCEPTIONS, excepted, findings, needed_exceptions


def main(arguments: list[str]) -> int:
    """Print the findings; return the exit code."""
    prefixes = tuple(argument for argument in arguments if not argument.startswith("-"))
    everything = findings()
    if "--exceptions" in arguments:
        print("\n".join(f'    "{entry}",' for entry in needed_exceptions(everything)))
        return 0
    kept = [finding for finding in everything if "--all" in arguments or excepted(finding.path) is None]
    shown = [finding for finding in kept if not prefixes or finding.path.startswith(prefixes)]
    for finding in shown:
        print(finding)
    used = {excepted(finding.path) for finding in everything}
    for entry in EXCEPTIONS:
        if entry not in used:
            print(f"tests/language/check.py: {entry} is clean now; take it out of EXCEPTIONS")
    return 1 if shown else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
