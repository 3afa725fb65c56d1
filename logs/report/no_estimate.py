"""Page of a log without estimate: reason, rates, gaps, decisions."""

from collections import Counter
from importlib import resources

from logs.evaluation.collected import NoEstimateError
from logs.report.gather import Gathered
from logs.report.words import at_fault
from models import web_page
from models.web_page import BAD, text

_VERDICT = "no estimate"


def page(name: str, missing: NoEstimateError, gathered: Gathered) -> str:
    """The page; times from the first message."""
    start_ns = min((t.first_ns for t in gathered.traffic.values()), default=0)
    torn = "<p>The log is truncated: read to its last whole record.</p>" if missing.torn else ""
    tables = "".join(map(web_page.table, (topics(gathered, start_ns), _measurements(missing), _remarks(gathered, start_ns))))
    causes = "".join(f"<p>{text(cause.text)}</p>" for cause in at_fault(missing.attachments))
    body = (
        f"<h1>{text(name)}</h1><p>{web_page.verdict(_VERDICT, BAD)}</p>{causes}<p>{text(str(missing))}</p>{torn}"
        f"{tables}"
        '<p class="faint">landfix doctor LOG -c CONFIG checks units, axes and stamps, and says what to do.</p>'
    )
    css = resources.files("logs.report").joinpath("page.css").read_text(encoding="utf-8")
    return web_page.page(f"landfix: {name}", body, css, "")


def topics(gathered: Gathered, start_ns: int) -> web_page.Table:
    """Rate and longest silence of every topic."""
    rows = []
    for topic, t in sorted(gathered.traffic.items()):
        span = (t.last_ns - t.first_ns) * 1e-9
        rate = f"{(t.count - 1) / span:.1f}" if span > 0 else "-"
        silent_from = f"{round((t.silent_from_ns - start_ns) * 1e-9, 1) + 0.0:.1f}"
        silent = (f"{t.silence_ns * 1e-9:.3g}", silent_from) if t.count > 1 else ("-", "-")
        rows.append((topic, t.schema, str(t.count), rate, *silent))
    return "Topics in the log", ("topic", "type", "messages", "Hz", "longest silence s", "from s"), rows


def _measurements(missing: NoEstimateError) -> web_page.Table:
    groups = Counter((aid.topic, aid.kind, str(aid.reason)) for aid in missing.aids)
    words = {(aid.topic, aid.kind, str(aid.reason)): aid.detail for aid in missing.aids if aid.detail}
    rows = [(*group, str(count), words.get(group, "")) for group, count in groups.most_common()]
    return "What became of the measurements", ("source", "kind", "reason", "how many", "for example"), rows


def _remarks(gathered: Gathered, start_ns: int) -> web_page.Table:
    first: dict[str, int] = {}
    for stretch in gathered.details:
        if stretch.state:
            first.setdefault(stretch.state, stretch.t_ns)
    rows = [(f"{(t_ns - start_ns) * 1e-9:.1f}", remark) for remark, t_ns in first.items()]
    return "What was missing", ("from s", ""), rows[:50]
