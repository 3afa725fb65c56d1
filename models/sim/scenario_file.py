"""A scenario from TOML, strictly: unknown keys are refused by name."""

import difflib
import math
import re
from collections.abc import Iterator
from typing import Any

import msgspec
import msgspec.inspect as mi

from models.sim.scenario import Scenario
from models.untrusted import toml_text

_KIND = "kind"  # says which vehicle, which fault: the tag field of those structs


class ScenarioError(ValueError):
    """One clear line: which file, which key, what is wrong."""


def loads(text: str | bytes, name: str = "scenario") -> Scenario:
    """The scenario of a TOML text or bytes, called `name`. Raises ScenarioError."""
    try:
        table = toml_text.table(toml_text.decode(text) if isinstance(text, bytes) else text)
        _check(mi.type_info(Scenario), table, "")
        return msgspec.convert(table, Scenario)
    except msgspec.ValidationError as error:
        what = re.sub(r" - at `\$\.?(.*)`$", r" in '\1'", str(error)).replace("`", "")
        raise ScenarioError(f"{name}: {what[:1].lower()}{what[1:]}") from None
    except ValueError as error:  # ScenarioError too
        raise ScenarioError(f"{name}: {error}") from None


def _check(info: mi.Type, value: Any, path: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise ScenarioError(f"{path} = {value}: must be a finite number")
    if isinstance(value, list):
        item_type = next((t.item_type for t in _alternatives(info) if isinstance(t, mi.VarTupleType)), mi.AnyType())
        for item in value:
            _check(item_type, item, path)
    structs = [t for t in _alternatives(info) if isinstance(t, mi.StructType)]
    if not isinstance(value, dict) or not structs:
        return
    kinds = {str(t.tag): t for t in structs if t.tag_field}
    if kinds and _KIND not in value:
        raise ScenarioError(f"[{path}] needs its kind, one of {', '.join(kinds)}")
    kind = str(value.get(_KIND))
    if kinds and kind not in kinds:
        raise ScenarioError(_unknown(_KIND, kind, list(kinds), path))
    struct = kinds.get(kind, structs[0])
    fields = {f.encode_name: f.type for f in struct.fields}
    for key, item in value.items():
        if key in fields:
            _check(fields[key], item, f"{path}.{key}" if path else key)
        elif not (kinds and key == _KIND):
            raise ScenarioError(_unknown("key", key, list(fields), path))


def _alternatives(info: mi.Type) -> Iterator[mi.Type]:
    if isinstance(info, mi.Metadata):
        yield from _alternatives(info.type)
    elif isinstance(info, mi.UnionType):
        for part in info.types:
            yield from _alternatives(part)
    else:
        yield info


def _unknown(what: str, given: str, known: list[str], path: str) -> str:
    near = difflib.get_close_matches(given, known, n=1, cutoff=0.5)
    where = f" in [{path}]" if path else ""
    hint = f"; did you mean '{near[0]}'?" if near else ""
    return f"unknown {what} '{given}'{where}{hint} (known: {', '.join(known)})"
