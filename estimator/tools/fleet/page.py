"""A comparison as one HTML page: fleet, groups, flights, the worst first."""

from collections.abc import Mapping, Sequence
from typing import Final

from estimator.tools.fleet.compare import Change, Comparison, MetricChange, words
from estimator.tools.fleet.metrics import RANKED
from models.web_page import BAD, GOOD, page, table, text, verdict

Links = Sequence[tuple[str, str]]  # words, address

_MOST: Final = 100  # flights on the page, of each end


def write(c: Comparison, reports: Mapping[str, Links]) -> str:
    """Write the page; reports: log -> label and file."""
    before, after = (text(label) for label in c.labels)
    word = f"{c.worse} of {c.pairs} flights worse, {c.better} better" if c.worse or c.better else "no flight differs"
    head = f"<h1>{after} against {before}</h1><p>{verdict(word, BAD if c.worse or c.broken else GOOD)}</p>"
    alone = f"{c.only_before} under {c.labels[0]}, {c.only_after} under {c.labels[1]}" if c.only_before or c.only_after else ""
    facts = [
        ("flights compared", str(c.pairs)),
        *([("flights with one row only", alone)] if alone else []),
        *([("flights whose inputs differ", str(c.differing))] if c.differing else []),
        *((f"budget broken: {b.budget}", f"{b.share_percent:.2f} % of the flights") for b in c.broken),
    ]
    metrics = [_metric(m) for m in c.metrics if m.worse or m.better]
    equal = ", ".join(m.metric for m in c.metrics if m.pairs and not m.worse and not m.better)
    groups = [(g.value, str(g.pairs), str(g.worse), str(g.better), f"{g.median_percent:+.2f} %") for g in c.groups]
    worse = [x for x in c.changes if x.worse > (0.0 if x.log in reports else c.least)][:_MOST]
    better = [x for x in c.changes[::-1] if x.worse < -c.least][:_MOST]
    remark = f"A flight is as much worse as the worst of {', '.join(RANKED)}."
    remark += "" if reports else " Reports of the worst flights, before and after: the same command with --reports 10."
    body = head + "".join((
        table(("", (), facts)),
        table(("Metrics", ("metric", "flights", "worse", "better", "noise", "median change", "p (signed rank)"), metrics)),
        f'<p class="faint">Equal on all flights: {text(equal)}.</p>' if equal else "",
        table((f"By {c.by}", (c.by, "flights", "worse", "better", "median change"), groups)),
        f'<p class="faint">{text(remark)}</p>' if worse or better else "",
        _flights("Worse, the worst first", worse, reports),
        _flights("Better, the best first", better, reports),
    ))  # fmt: skip
    return page(f"{c.labels[1]} against {c.labels[0]}", body)


def _metric(m: MetricChange) -> tuple[str, ...]:
    p = "-" if m.p is None else f"{m.p:.2g}"
    return m.metric, str(m.pairs), str(m.worse), str(m.better), f"{m.noise:.2g}", f"{m.median_percent:+.2f} %", p


def _flights(title: str, changes: list[Change], reports: Mapping[str, Links]) -> str:
    if not changes:
        return ""
    made = any(change.log in reports for change in changes)
    lines = "".join(_flight(change, reports.get(change.log, ()) if made else None) for change in changes)
    head = f"<tr><th>flight</th><th>change</th>{'<th>report</th>' if made else ''}</tr>"
    return f'<h3>{text(title)}</h3><div class="wide"><table>{head}{lines}</table></div>'


def _flight(change: Change, links: Links | None) -> str:
    made = " ".join(f'<a href="{text(href)}">{text(label)}</a>' for label, href in links or ())
    made = "" if links is None else f"<td>{made}</td>"
    return f"<tr><td>{text(change.log)}</td><td>{text(words(change))}</td>{made}</tr>"
