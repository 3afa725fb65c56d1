"""When the estimate begins, and how good it is from then on.

python -m benchmarks.starts                      both tables, a quarter of an hour of two cores
python -m benchmarks.starts --only recorded      recorded flights and logs, or: simulated
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import Final

from benchmarks.starts import recorded, simulated

TABLES: Final = {"recorded": recorded.table, "simulated": simulated.table}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES), help="which table; default: both")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs) as pool:
        found = [TABLES[name](pool) for name in given.only]
    print(*(table.markdown() for table in found), sep="\n")


if __name__ == "__main__":
    main()
