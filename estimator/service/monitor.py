"""What `landfix monitor` shows."""

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import StringIO
from pathlib import Path
from typing import Any, Final

import numpy as np
import zenoh
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from estimator.service.zenoh.bus import BusError
from estimator.service.zenoh.config import ZenohConfig, client_config
from estimator.service.zenoh.keys import rmw_key
from estimator.sources.gnss import FLAGGED
from logs.wire import schemas
from logs.wire.codec import INTEGRITY_TOPIC, Odometry, decode_aid_status, decode_diagnostics, decode_integrity, decode_odometry
from logs.wire.schemas import STORE
from models import so3
from models.messages import Alert, Integrity
from models.untrusted.toml_text import one_line

_STALE_S: Final = 2.0
_RECENT: Final = 200  # measurements of a source whose fate is shown, and estimates whose rate is
_MODES: Final = {
    "aided": "green",
    "odometry": "cyan",
    "dead_reckoning": "yellow",
    "coasting": "red",
    "aligning": "yellow",
    "aligning_heading": "yellow",
    "starting": "yellow",
}
_ALERTS: Final = {Alert.NOT_JUDGED: "", Alert.USABLE: "green", Alert.CAUTION: "yellow", Alert.DO_NOT_USE: "bold red"}
_WIDTH: Final = 100
_MOST_TOPICS: Final = 100
_REFRESH_HZ: Final = 5.0
_ANSWER_S: Final = 3.0


class View:
    """Collects inputs; render() makes a screen. now_s: steady clock."""

    def __init__(self) -> None:
        self.health: dict[str, str] = {}
        self.daemon: dict[str, str] = {}
        self.odometry: Odometry | None = None
        self.integrity: Integrity | None = None
        self.place: tuple[float, float, float] | None = None  # lat_deg, lon_deg, alt_m
        self._heard_s: dict[str, float] = {}
        self._malformed = Counter[str]()
        self._stamps_ns: deque[int] = deque(maxlen=_RECENT)  # of estimates
        self._aids: dict[str, deque[tuple[str, float, float, str]]] = {}  # reason, test ratio, delay, detail

    def hear(self, topic: str, data: bytes, now_s: float) -> None:
        """One message of the daemon's, or of whoever sends in its name."""
        try:
            self._take(topic, data)
        except Exception:  # whatever a peer's bytes trip over
            self._malformed[topic] += 1
        else:
            self._heard_s[topic] = now_s

    def _take(self, topic: str, data: bytes) -> None:
        if topic == "/landfix/odometry":
            self.odometry = decode_odometry(data)
            self._stamps_ns.append(self.odometry.t_ns)
        elif topic == "/landfix/health":
            self.health = decode_diagnostics(data)
        elif topic == INTEGRITY_TOPIC:
            self.integrity = decode_integrity(data)
        elif topic == "/landfix/daemon":
            self.daemon = decode_diagnostics(data)
        elif topic == "/landfix/aid_status":
            status = decode_aid_status(data)
            if status.topic in self._aids or len(self._aids) < _MOST_TOPICS:
                seen = self._aids.setdefault(status.topic, deque(maxlen=_RECENT))
                seen.append((status.reason, status.test_ratio, status.delay_s, status.detail))
        elif topic == "/landfix/global":
            message: Any = STORE.deserialize_cdr(data, schemas.NAV_SAT_FIX)
            self.place = message.latitude, message.longitude, message.altitude

    def render(self, now_s: float, connected: str) -> RenderableType:
        """The screen."""
        age_s = now_s - max(self._heard_s.values(), default=-math.inf)
        if age_s > _STALE_S:
            text = "nothing heard yet" if math.isinf(age_s) else f"nothing heard for {age_s:.0f} s"
            return Panel(Text(f"{text} from {connected}; is landfix running, and may we listen?", style="red"), width=_WIDTH)
        try:
            parts: list[RenderableType] = [self._state(), self._sources(), self._works()]
        except (ArithmeticError, LookupError, ValueError) as error:  # values that no daemon of ours sends
            parts = [Text(f"what is sent as the daemon's is malformed: {one_line(str(error))}", style="red")]
        parts += [Text(f"malformed messages on {topic}: {n}", style="red") for topic, n in self._malformed.items()]
        return Group(*parts)

    def _state(self) -> Panel:
        health, mode = self.health, self.health.get("mode", "unknown")
        table = _table("", "")
        table.add_row("mode", Text(mode, style=f"bold {_MODES.get(mode, 'red')}"))
        table.add_row("last absolute fix", _age(health.get("absolute_age_s")))
        table.add_row("95 % radius", _metres(health.get("radius95_m")))
        if (found := self.integrity) is not None:
            table.add_row("integrity", _alert(found))
        if o := self.odometry:
            n, e, d = o.p_n
            table.add_row("position", f"north {n:9.2f} m   east {e:9.2f} m   up {-d:8.2f} m")
            roll, pitch, yaw = (round(math.degrees(a), 1) + 0.0 for a in so3.to_euler(np.array(o.q_nb_wxyz)))  # no -0.0
            speed = math.hypot(*o.v_n)
            attitude = f"roll {roll:6.1f}°  pitch {pitch:6.1f}°  heading {yaw % 360:5.1f}°"
            table.add_row("attitude, speed", f"{attitude}   {speed:5.1f} m/s")
        if self.place:
            lat, lon, alt = self.place
            table.add_row("on Earth", f"{lat:.6f}°  {lon:.6f}°  {alt:.1f} m")
        table.add_row("estimates", f"{self._rate_hz():.0f} Hz, {health.get('reset_counter', '?')} resets")
        if detail := health.get("detail"):
            table.add_row("detail", Text(detail, style="bold red" if "internal error" in detail else "yellow"))
        if (defects := health.get("counts internal", "0")) != "0":
            table.add_row("internal errors", Text(defects, style="bold red"))
        return Panel(table, title="landfix", title_align="left", width=_WIDTH)

    def _sources(self) -> Panel:
        table = _table("source", "state", "rate", "delay", "test ratio", "fate of the last measurements", header=True)
        rates = {key.removeprefix("rate_hz "): rate for key, rate in self.daemon.items() if key.startswith("rate_hz ")}
        for topic in sorted({*rates, *self._aids} - {"", "/landfix/tick", "/landfix/checkpoint"}):
            seen = tuple(self._aids.get(topic, ()))  # Zenoh's thread goes on hearing
            ratios = sorted(ratio for reason, ratio, _, _ in seen if reason in {"fused", "gated"})
            delay = f"{seen[-1][2] * 1e3:.0f} ms" if seen else ""
            ratio = f"{ratios[len(ratios) // 2]:.2f}" if ratios else ""
            state = self.health.get(f"sources {topic}", "")
            colour = {"active": "green", "starting": "yellow", "stopped": "red"}.get(state, "")
            fates = _fates(reason for reason, *_ in seen)
            if seen and seen[-1][3].startswith(FLAGGED):
                fates = Text(f"{seen[-1][3].removeprefix(FLAGGED)}; ", style="bold red") + fates
            table.add_row(topic, Text(state, style=colour), f"{rates.get(topic, '0')} Hz", delay, ratio, fates)
        return Panel(table, title="sources", title_align="left", width=_WIDTH)

    def _works(self) -> Panel:
        table, d = _table("", ""), self.daemon
        for title, name in (("sensor to estimate", "latency_ms"), ("of that, here", "handling_ms")):
            quantiles = " / ".join(d.get(f"{name} {k}", "-") for k in ("p50", "p99", "max"))
            table.add_row(title, f"{quantiles} ms   (p50 / p99 / max)")
        state = d.get("log state", "unknown")
        lost = str(int(d.get("log lost_inputs", "0")) + int(d.get("inbox lost_inputs", "0")))
        colour = "green" if state in {"recording", "off"} and lost == "0" else "red"
        written_mb, waiting_kb = float(d.get("log bytes_written", "0")) / 1e6, float(d.get("log waiting_bytes", "0")) / 1e3
        table.add_row("log", Text(f"{state}   {written_mb:.1f} MB, {waiting_kb:.0f} kB waiting", style=colour))
        table.add_row("", d.get("log file", ""))
        dropped = f"{lost} inputs, {d.get('log dropped_images', '0')} images, {d.get('log dropped_outputs', '0')} outputs"
        table.add_row("not logged", Text(dropped, style="" if lost == "0" else "red"))
        refused = f"{d.get('zenoh oversized', '0')} too large, {d.get('implausible_stamps', '0')} with implausible stamps"
        table.add_row("refused", refused)
        steps = d.get("clock wall_steps", "0")
        clock = f"wall clock {float(d.get('clock wall_ahead_s', '0')):+.3f} s since the start, {steps} steps"
        table.add_row("clock", Text(clock, style="" if steps == "0" else "yellow"))
        for name, text, well in _links(d):
            table.add_row(name, Text(text, style="" if well else "yellow"))
        table.add_row("running", f"{float(d.get('uptime_s', '0')):.0f} s, {d.get('zenoh links', '0')} others on the bus")
        if failed := d.get("estimator"):
            table.add_row("estimator", Text(failed, style="bold red"))
        if (removed := d.get("log removed_files", "0")) != "0":
            table.add_row("", Text(f"{removed} log files were removed while they were written", style="red"))
        for topic, count in ((key.removeprefix("inbox dropped "), n) for key, n in d.items() if key.startswith("inbox dropped ")):
            table.add_row("flooded", Text(f"{topic}: {count} messages dropped", style="red"))
        if defect := d.get("internal_error"):
            table.add_row("internal errors", Text(f"{d['internal_errors']}, the last: {defect}", style="red"))
        return Panel(table, title="daemon", title_align="left", width=_WIDTH)

    def _rate_hz(self) -> float:
        stamps = self._stamps_ns
        return 1e9 * (len(stamps) - 1) / (stamps[-1] - stamps[0]) if len(stamps) > 1 and stamps[-1] > stamps[0] else 0.0


@contextmanager
def connected(config: ZenohConfig, folder: Path, endpoint: str | None) -> Iterator[tuple[zenoh.Session, str]]:
    """A session with the daemon, and its address. Raises BusError."""
    endpoint = endpoint or (config.listen or config.connect)[0]
    try:
        session = zenoh.open(client_config(config, folder, endpoint))
    except zenoh.ZError:
        raise BusError(f"{endpoint}: no daemon listens there, or it refuses the connection") from None
    with session:
        yield session, endpoint


def asked(session: zenoh.Session, query: str) -> str:
    """The daemon's answer to "status" (JSON), "config" (TOML) ... Raises BusError."""
    for reply in session.get(f"landfix/{query}", timeout=_ANSWER_S):
        if reply.ok is not None:
            return reply.ok.payload.to_string()
    raise BusError("the daemon does not answer; is landfix running, and may we ask?")


def watch(session: zenoh.Session, domain: int, endpoint: str, seconds: float | None, picture: Path | None) -> None:
    """Show the screen for `seconds`; save the last one. Raises BusError."""
    view = View()
    kept = _listen(session, domain, view)
    console = Console()
    end_s = time.monotonic() + (seconds or math.inf)
    with Live(console=console, auto_refresh=False, screen=console.is_terminal) as live, suppress(KeyboardInterrupt):
        while time.monotonic() < end_s:
            if console.is_terminal:
                live.update(view.render(time.monotonic(), endpoint), refresh=True)
            time.sleep(1.0 / _REFRESH_HZ)
    for subscriber in kept:
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    screen = view.render(time.monotonic(), endpoint)
    if not console.is_terminal:
        console.print(screen)
    if picture is not None:
        _save(screen, picture)


def _save(screen: RenderableType, picture: Path) -> None:
    paper = Console(record=True, width=_WIDTH, file=StringIO())
    paper.print(screen)
    try:
        paper.save_svg(str(picture), title="landfix monitor")
    except OSError as error:
        raise BusError(f"{picture}: cannot be written ({(error.strerror or 'unknown error').lower()})") from None


def _listen(session: zenoh.Session, domain: int, view: View) -> list[zenoh.Subscriber[None]]:
    topics = {
        "/landfix/odometry": schemas.ODOMETRY,
        "/landfix/health": schemas.DIAGNOSTICS,
        INTEGRITY_TOPIC: schemas.INTEGRITY,
        "/landfix/daemon": schemas.DIAGNOSTICS,
        "/landfix/aid_status": schemas.AID_STATUS,
        "/landfix/global": schemas.NAV_SAT_FIX,
    }

    def hear(topic: str) -> Callable[[zenoh.Sample], None]:
        return lambda sample: view.hear(topic, sample.payload.to_bytes(), time.monotonic())

    return [session.declare_subscriber(rmw_key(domain, topic, schema), hear(topic)) for topic, schema in topics.items()]


def _fates(reasons: Iterable[str]) -> Text:
    counted = Counter(reasons).most_common()
    return Text(", ").join(Text(f"{n} {reason}", style="green" if reason == "fused" else "yellow") for reason, n in counted)


def _links(d: Mapping[str, str]) -> Iterator[tuple[str, str, bool]]:
    if state := d.get("vision state"):
        seen = f"{d['vision fixes']} fixes of {d['vision pairs']} pairs, {d['vision latency_ms']} ms"
        yield "vision", f"{state}   {seen}, {d['vision restarts']} restarts", state in {"ready", "seeing"}
    if state := d.get("mavlink state"):
        heard_s = d["mavlink heard_s"]
        heard = "no heartbeat yet" if heard_s == "never" else f"{d['mavlink autopilot']} heard {heard_s} s ago"
        yield "mavlink", f"{state}   {heard}, {_sent(d, 'mavlink')}", state == "open" and heard_s != "never"
        if ekf := ekf_line(d):
            yield "its EKF", ekf, "not fused" not in ekf
        if heading := d.get("mavlink attitude"):
            yield "its attitude", heading, False
    if ahead := d.get("px4 clock_ahead_s"):
        heard = "nothing of fmu/out comes" if ahead == "unknown" else "heard"
        yield "px4", f"{heard}, {_sent(d, 'px4')}", ahead != "unknown"
    for link in ("mavlink", "px4"):
        if origin := d.get(f"{link} ekf_origin"):
            yield "its origin", origin, "quality -1" not in origin
        if receiver := d.get(f"{link} receiver"):
            yield "its receiver", receiver, True


def _sent(d: Mapping[str, str], link: str) -> str:
    odometry, quality, fixes = (d[f"{link} {name}"] for name in ("odometry", "quality", "fixes"))
    return f"sent {odometry} odometry (quality {quality}), {fixes} fixes"


def ekf_line(d: Mapping[str, str]) -> str:
    """What the autopilot's EKF fuses, as the daemon's status has it; "" where it has not said."""
    fuses, source_set = d.get("mavlink ekf_fuses", ""), d.get("mavlink ekf_source_set", "")
    return "   ".join(filter(None, (f"fuses {fuses}" if fuses else "", f"source set {source_set}" if source_set else "")))


def _age(given: str | None) -> Text:
    age_s = float(given or "inf")
    if math.isinf(age_s):
        return Text("never", style="yellow")
    return Text(f"{age_s:.1f} s ago", style="green" if age_s < _STALE_S + 1 else "yellow")


def _alert(integrity: Integrity) -> Text:
    i = integrity
    levels = (("HPL", i.hpl_m, i.hal_m), ("VPL", i.vpl_m, i.val_m))
    shown = ", ".join(
        f"{name} {level:.1f}{'' if math.isinf(limit) else f' of {limit:g}'} m" if math.isfinite(level) else f"{name} unbounded"
        for name, level, limit in levels
    )
    state = f"{i.state}, no alert limits configured" if i.state is Alert.NOT_JUDGED else str(i.state)
    words = f"{state}   {shown} at {i.risk_per_hour:g} per hour"
    return Text(f"{words}\n{i.reason}" if i.reason else words, style=_ALERTS[i.state])


def _metres(given: str | None) -> str:
    radius_m = float(given or "inf")
    return "unknown" if math.isinf(radius_m) else f"{radius_m:.2f} m"


class _Table(Table):
    """Peers' strings are not markup."""

    def add_row(self, *cells: RenderableType | None, **how: Any) -> None:
        super().add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells), **how)


def _table(*columns: str, header: bool = False) -> Table:
    table = _Table(box=None, show_header=header, pad_edge=False, header_style="dim")
    for k, name in enumerate(columns):
        table.add_column(name, style="dim" if k == 0 and not header else "", no_wrap=k == 0)
    return table
