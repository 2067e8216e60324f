"""`python -m tests.language`: print broken links and breaches of the language rules; exit code 1 if there is one.

Arguments keep the paths that begin with one of them.
"""

from __future__ import annotations

import sys

from tests.language.check import findings


def main(arguments: list[str]) -> int:
    """Print the findings; return the exit code."""
    prefixes = tuple(arguments)
    shown = [finding for finding in findings() if not prefixes or finding.path.startswith(prefixes)]
    for finding in shown:
        print(finding)
    return 1 if shown else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
