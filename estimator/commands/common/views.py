"""Views of a board, and pairs of views."""

from collections.abc import Callable, Sequence

from calib.board.chessboard import Board, View, Why, find, size_around, size_seen
from calib.cameras.mono import Dropped
from calib.cameras.selection import FEWEST
from calib.cameras.stereo import Pair
from calib.errors import CalibrationError
from estimator.commands.common.image_source import MOST_FRAMES, SourceImage, is_live, live, read_images
from vision.image.rectify import Image

Keyed = tuple[int, View]

_SAME_TIME_NS = 5_000_000
_HINTS = 2  # images searched for a board of another size


class _Gathered:
    def __init__(self, board: Board) -> None:
        self._board = board
        self._views: list[Keyed] = []
        self._unused: list[Dropped] = []
        self._without: list[Image] = []
        self._shown: list[Image] = []

    def add(self, image: SourceImage) -> None:
        if image.fault:
            self._unused.append(Dropped(image.name, image.fault))
            return
        found = find(image.image, self._board, image.name)
        if isinstance(found, View):
            self._views.append((image.key, found))
            self._shown += [image.image] * (len(self._shown) < _HINTS)
        else:
            self._unused.append(Dropped(image.name, found.value))
            self._without += [image.image] * (found is Why.NOT_FOUND and len(self._without) < _HINTS)

    def checked(self) -> tuple[list[Keyed], list[Dropped]]:
        _check_whole(self._board, self._shown)
        if len(self._views) < FEWEST:
            sizes = [size_seen(image, self._board) for image in self._without]
            raise CalibrationError(_why_few(self._board, len(self._views), self._unused, sizes))
        return self._views, self._unused


def gather(
    sources: Sequence[str], topic: str, board: Board, progress: Callable[[float], None], most: int = MOST_FRAMES
) -> tuple[list[Keyed], list[Dropped]]:
    """Views with keys, and images without. Raises CalibrationError."""
    gathered = _Gathered(board)
    for image in read_images(sources, topic, most):
        gathered.add(image)
        progress(image.done)
    return gathered.checked()


def gather_pairs(
    left: Sequence[str], right: Sequence[str], topics: tuple[str, str], board: Board, progress: Callable[[float], None]
) -> tuple[list[Pair], list[Dropped]]:
    """Pairs of views, and images without one."""
    if [is_live(s) for s in (*left, *right)] == [True, True]:
        sides = _Gathered(board), _Gathered(board)
        for taken in live([*left, *right]):
            for side, image in zip(sides, taken, strict=True):
                side.add(image)
            progress(taken[0].done)
        (left_views, left_unused), (right_views, right_unused) = (side.checked() for side in sides)
    else:
        left_views, left_unused = gather(left, topics[0], board, lambda f: progress(0.5 * f))
        right_views, right_unused = gather(right, topics[1], board, lambda f: progress(0.5 + 0.5 * f))
    pairs, unpaired = pair(left_views, right_views)
    return pairs, [*left_unused, *right_unused, *unpaired]


def pair(left: Sequence[Keyed], right: Sequence[Keyed]) -> tuple[list[Pair], list[Dropped]]:
    """Views of equal key or nearest time, and the others. Raises CalibrationError."""
    keys = dict(right)
    if len(keys) < len(right) or len({key for key, _ in left}) < len(left):
        raise CalibrationError("two images of one camera have the same number; number them 01, 02, ... as their partners")
    stamps = any(key > 10**15 for key in keys)
    pairs, unpaired = [], []
    for key, view in left:
        partner = min(keys, key=lambda k: abs(k - key), default=None)
        if partner is not None and abs(partner - key) <= (_SAME_TIME_NS if stamps else 0):
            pairs.append(Pair(view, keys.pop(partner)))
        else:
            unpaired.append(Dropped(view.name, "no partner with a view of the board"))
    unpaired += [Dropped(view.name, "no partner with a view of the board") for view in keys.values()]
    if not pairs:
        raise CalibrationError(
            f"{len(left)} left and {len(right)} right views, but no pair among them: "
            "images taken together must have the same number, or stamps within 5 ms"
        )
    return pairs, unpaired


def _check_whole(board: Board, shown: Sequence[Image]) -> None:
    size = size_around(shown[0], board) if shown else None
    if size is not None and all(size_around(image, board) == size for image in shown[1:]):
        raise CalibrationError(
            f"the images show a board of {size[0]}x{size[1]} inner corners, not {board.columns}x{board.rows}: is --board right?"
        )


def _why_few(board: Board, views: int, unused: Sequence[Dropped], sizes: Sequence[tuple[int, int] | Why | None]) -> str:
    size, total = f"{board.columns}x{board.rows}", views + len(unused)
    blurred = sum(d.reason == Why.BLURRED for d in unused)
    seen = [s for s in sizes if isinstance(s, tuple)]
    if not views and unused and not any(d.reason in set(Why) for d in unused):
        return f"{unused[0].name}: {unused[0].reason}"
    if blurred > len(unused) / 2 or Why.BLURRED in sizes:
        many = f"{blurred} of {total}" if blurred else "the"
        return f"{many} images are blurred: hold the board still, focus, give more light"
    if seen and not views:
        return f"no {size} board in {total} images, but one of {seen[0][0]}x{seen[0][1]} inner corners: is --board right?"
    if not views:
        return f"no {size} board found in {total} images: the whole board with a white border must be seen, sharp and evenly lit"
    return (
        f"{views} usable views of the board in {total} images, at least {FEWEST} are needed (20 are good): take more images, "
        "the whole board in each, tilted 20-45 degrees each way"
    )
