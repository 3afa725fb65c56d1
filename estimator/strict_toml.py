"""TOML <-> parameter structs, strictly.

Fields: `Annotated[float, msgspec.Meta(gt=0, description="m/s: what it means")]`; unit before the colon, or the name's suffix.
"""

import difflib
import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import msgspec
import msgspec.inspect as mi

from models.untrusted import toml_text

T = TypeVar("T", bound=msgspec.Struct)

_UNITS = {"s": "s", "ms": "ms", "ns": "ns", "m": "m", "mps": "m/s", "mps2": "m/s^2", "deg": "deg", "dps": "deg/s", "rad": "rad",
          "hz": "Hz", "px": "px", "pa": "Pa", "m2": "m^2"}  # fmt: skip


_SMALLEST = 1e-12  # of what is not 0: of no quantity here less is meant, and its inverse would overflow
_LARGEST = 2**53  # of whole numbers, which a float holds


class ConfigError(ValueError):
    """One clear line: which file, which key, what is wrong."""


class Key(NamedTuple):
    """A row of the table of keys; default as TOML ("-": none)."""

    section: str
    name: str
    default: str
    unit: str
    meaning: str


def decode(kind: type[T], text: str, name: str, *, is_recorded: bool = False) -> T:
    """The struct `kind` from TOML called `name`; is_recorded: without the keys that were removed. Raises ConfigError."""
    try:
        table = toml_text.table(text)
        checked = _checked(_struct(mi.type_info(kind)), table, "", is_recorded=is_recorded)
    except ValueError as error:  # ConfigError too
        raise ConfigError(f"{name}: {error}") from None
    try:
        return msgspec.convert(checked, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{name}: {_explain(str(error), table)}") from None


def encode(value: msgspec.Struct) -> str:
    """All keys of a struct of structs as TOML, defaults included, None omitted."""
    return "\n".join(_sections(value, "")).lstrip("\n") + "\n"


def keys(kind: type[msgspec.Struct]) -> list[Key]:
    """Every key of a struct of structs, in the order of declaration."""
    return list(_keys(_struct(mi.type_info(kind)), ""))


def _struct(info: mi.Type) -> mi.StructType:
    assert isinstance(info, mi.StructType)
    return info


def _alternatives(info: mi.Type) -> tuple[mi.Type, ...]:
    if isinstance(info, mi.Metadata):
        return _alternatives(info.type)
    return tuple(a for t in info.types for a in _alternatives(t)) if isinstance(info, mi.UnionType) else (info,)


def _nested(info: mi.Type) -> mi.StructType | None:
    return next((a for a in _alternatives(info) if isinstance(a, mi.StructType)), None)


def _checked(info: mi.StructType, table: Mapping[str, Any], path: str, *, is_recorded: bool = False) -> dict[str, Any]:
    fields = {f.encode_name: f.type for f in info.fields}
    result = {}
    for key, value in table.items():
        where = f"{path}.{key}" if path else key
        if key in fields:
            nested = _nested(fields[key]) if isinstance(value, dict) else None
            result[key] = _checked(nested, value, where, is_recorded=is_recorded) if nested else _value(fields[key], value, where)
        elif not (is_recorded and _advice(key, path)):
            raise ConfigError(_unknown(key, list(fields), path))
    return result


def _value(info: mi.Type, value: Any, path: str) -> Any:
    alternatives = _alternatives(info)
    if isinstance(value, dict):
        struct = _nested(info)
        return _checked(struct, value, path) if struct else value
    if isinstance(value, str) and not value.isprintable():
        raise ConfigError(f"{path} = {_shown(value)}: holds a character that cannot be printed")
    if isinstance(value, str) and any(isinstance(a, mi.VarTupleType) for a in alternatives):
        return [value]
    if isinstance(value, list):
        tuples = [a for a in alternatives if isinstance(a, mi.TupleType) and len(a.item_types) == len(value)]
        return (
            [_value(t, v, f"{path}[{i}]") for i, (t, v) in enumerate(zip(tuples[0].item_types, value, strict=True))]
            if tuples
            else [_value(_item(alternatives), v, f"{path}[{i}]") for i, v in enumerate(value)]
        )
    choices = [choice for a in alternatives if isinstance(a, mi.LiteralType) for choice in a.values]
    if choices and value not in choices:
        raise ConfigError(f"{path} = {_shown(value)}: must be one of {', '.join(map(str, choices))}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{path} = {value}: must be a finite number")
    if isinstance(value, float) and 0.0 < abs(value) < _SMALLEST:
        raise ConfigError(f"{path} = {value}: must be 0 or at least {_SMALLEST:g} in size")
    if type(value) is int and abs(value) > _LARGEST:
        raise ConfigError(f"{path} = {_shown(value)}: must be at most {_LARGEST:_} in size")
    if type(value) is int and any(isinstance(a, mi.FloatType) for a in alternatives):
        return float(value)
    return value


def _item(alternatives: tuple[mi.Type, ...]) -> mi.Type:
    return next((a.item_type for a in alternatives if isinstance(a, mi.VarTupleType)), mi.AnyType())


def _shown(value: Any) -> str:
    try:
        text = json.dumps(value, default=str)
    except RecursionError:
        text = "a nested value"
    return toml_text.one_line(text, 80)


_REMOVED = {  # key, section.key or .section: what to do
    "fault_s": "leave it out: estimator/sources/base/faults.py has the durations of faults",
    "reset_after_s": "leave it out: consistent fixes win when they are more than those that they contradict",
    "cusum_slack": "leave it out: 1 sigma is tolerated",
    "cusum_limit": "leave it out: a source is rejected at 10 sigma of cumulated bias",
    **dict.fromkeys(
        ("gate_probability", "false_share", "probation", "hold_s", "spacing_s", "timeout_s"),
        "leave it out: estimator/sources/base/rules.py has how each source is judged",
    ),
    "stuck_s": "leave it out: a reading that is equal to the bit in motion is never used",
    "lasting_deg": "leave it out: what lasts of a rotation is not modelled",
    **{
        key: f"leave it out: it is a constant of estimator/{file}"
        for file, keys in {
            "sources/imu/choice.py": ".imus",
            "filter/alignment/initialise.py": "level_s still_accel still_rate level_moving_deg",
            "filter/alignment/core.py": "dead_reckoning_after_s",
            "sources/rest.py": "rest.every_s rest.after_s rest.gyro rest.accel rest.known_m_s rest.rate_sigma",
            "sources/air/drag.py": "drag.every_s drag.tilt_deg",
            "sources/air/airspeed.py": "sideslip_s",
            "sources/pose.py": "pose_fix.lasting_s landmark_fix.lasting_s",
            "sources/range.py": "sigma_share steepest_deg",
            "fusion.py": "future_s reset_sigma",
            "frontend/repeat.py": "replay_latency_ms",
            "service/base/clock.py": "ahead_s",
            "service/daemon.py": "tick_hz",
            "service/log/writer.py": "image_queue_mb",
        }.items()
        for key in keys.split()
    },
    "visual_odometry.timeout_s": "leave it out: [vision] timeout_s holds for odometry too",
    ".coast": "leave it out: models/imu.py has how a gap of the IMU is bridged",
}


def _advice(key: str, path: str) -> str | None:
    return _REMOVED.get(f"{path}.{key}") or (_REMOVED.get(key) if path else None)


def _unknown(key: str, known: list[str], path: str) -> str:
    key = toml_text.one_line(key, 80)
    where, what = (f"key '{key}' in [{path}]", f"keys of [{path}]") if path else (f"section [{key}]", "sections")
    if advice := _advice(key, path):
        return f"{where} was removed: {advice}"
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    hint = f"; did you mean '{near[0]}'?" if near else ";"
    return f"unknown {where}{hint} {what}: {', '.join(known)}"


def _explain(message: str, table: Mapping[str, Any]) -> str:
    """Turn "Expected `float` > 0.0 - at `$.imu.gyro_noise`" into "imu.gyro_noise = -1: expected float > 0.0"."""
    match = re.fullmatch(r"(?P<what>.*?)(?: - at `\$\.?(?P<path>[^`]*)`)?", message, re.DOTALL)
    what, path = (match["what"], match["path"] or "") if match else (message, "")
    value: Any = table
    for part in filter(None, re.split(r"[.\[]", path)):
        index = part.rstrip("]")
        if isinstance(value, Mapping):
            value = value.get(index, "")
        elif isinstance(value, list) and index.isdigit():
            value = value[int(index)]
    what = what.replace("`", "")
    given = "" if isinstance(value, dict) else f" = {_shown(value)}"
    return f"{path}{given}: {what[:1].lower()}{what[1:]}" if path else what


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(v) for v in value)}]"
    if isinstance(value, msgspec.Struct):
        given = msgspec.structs.asdict(value).items()
        return f"{{ {', '.join(f'{key} = {_toml(v)}' for key, v in given if v is not None)} }}"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)


def _sections(value: msgspec.Struct, path: str) -> Iterator[str]:
    items = [(f.encode_name, getattr(value, f.name)) for f in msgspec.structs.fields(value)]
    plain = [(k, v) for k, v in items if v is not None and not isinstance(v, msgspec.Struct)]
    if path and plain:
        yield f"\n[{path}]"
    for key, v in plain:
        yield f"{key} = {_toml(v)}"
    for key, v in items:
        if isinstance(v, msgspec.Struct):
            yield from _sections(v, f"{path}.{key}" if path else key)


def _keys(info: mi.StructType, path: str) -> Iterator[Key]:
    for field in info.fields:
        nested = _nested(field.type)
        if nested:
            yield from _keys(nested, f"{path}.{field.encode_name}" if path else field.encode_name)
            continue
        meaning, unit = _meaning(field)
        yield Key(path, field.encode_name, _default(field), unit, meaning)


def _meaning(field: mi.Field) -> tuple[str, str]:
    text = _description(field.type)
    match = re.fullmatch(r"(\S+): (.*)", text, re.DOTALL)
    if match:
        return match[2], match[1]
    return text, _UNITS.get(field.encode_name.rpartition("_")[2], "") if "_" in field.encode_name else ""


def _description(info: mi.Type) -> str:
    if isinstance(info, mi.Metadata):
        return str((info.extra_json_schema or {}).get("description", "")) or _description(info.type)
    return next(filter(None, map(_description, info.types)), "") if isinstance(info, mi.UnionType) else ""


def _default(field: mi.Field) -> str:
    value = field.default if field.default is not msgspec.NODEFAULT else None
    if field.default_factory is not msgspec.NODEFAULT:
        value = field.default_factory()
    return "-" if value is None else _toml(value)
