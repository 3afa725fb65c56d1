"""One boundary for what reads bytes from outside: any exception becomes one line."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from models.untrusted.toml_text import one_line


@contextmanager
def refusing(error: type[Exception], name: object, *passed: type[Exception]) -> Iterator[None]:
    """Raises `error`, one line, for any exception but those to pass."""
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are checked where they are used
            yield
    except (error, *passed) as failure:
        if isinstance(failure, error) and not (said := str(failure)).isprintable():
            raise error(one_line(said, 2000)) from None
        raise
    except MemoryError:
        raise error(f"{name}: declares more content than fits into memory") from None
    except (Exception, RecursionError) as failure:
        frames = traceback.extract_tb(failure.__traceback__)[1:]
        ours = [f for f in frames if "site-packages" not in f.filename and f.filename.endswith(".py")] or frames
        place = f"{Path(ours[-1].filename).stem}.{ours[-1].name}" if ours else "?"
        reason = one_line(f"{type(failure).__name__}: {failure}" if str(failure) else type(failure).__name__, 200)
        raise error(f"{name}: damaged, or not as its format says ({place}: {reason})") from None
