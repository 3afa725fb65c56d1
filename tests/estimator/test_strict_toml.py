from typing import Annotated, Literal

import msgspec
import pytest
from msgspec import Meta

from estimator.strict_toml import ConfigError, Key, decode, encode, keys


class Filter(msgspec.Struct, frozen=True):
    history_s: Annotated[float, Meta(gt=0, description="how late a measurement may come")] = 6.0
    noise: Annotated[float, Meta(ge=0, description="m/s: white noise")] = 0.1
    axes: Annotated[Literal["frd", "flu"], Meta(description="axes")] = "frd"


class Inputs(msgspec.Struct, frozen=True):
    imu: tuple[str, ...] = ("/imu",)
    origin: Annotated[tuple[float, float], Meta(description="deg: latitude, longitude")] | None = None


class Settings(msgspec.Struct, frozen=True):
    filter: Filter = Filter()
    inputs: Inputs = Inputs()


def message(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        decode(Settings, text, "x.toml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_given_replaces_the_default_and_the_rest_stays() -> None:
    settings = decode(Settings, '[filter]\nhistory_s = 2\naxes = "flu"\n', "x.toml")
    assert settings.filter == Filter(history_s=2.0, axes="flu")
    assert type(settings.filter.history_s) is float
    assert settings.inputs == Inputs()


def test_one_string_is_a_list_of_one() -> None:
    assert decode(Settings, '[inputs]\nimu = "/a"\n', "x").inputs.imu == ("/a",)
    assert decode(Settings, '[inputs]\nimu = ["/a", "/b"]\n', "x").inputs.imu == ("/a", "/b")
    assert decode(Settings, "[inputs]\nimu = []\n", "x").inputs.imu == ()


def test_an_unknown_key_is_named_with_its_nearest_neighbour() -> None:
    assert message("[filter]\nhistory = 2\n") == (
        "x.toml: unknown key 'history' in [filter]; did you mean 'history_s'? keys of [filter]: history_s, noise, axes"
    )


def test_a_key_that_was_removed_is_named_with_what_to_do() -> None:
    assert message("[filter]\nreset_after_s = 2\n") == (
        "x.toml: key 'reset_after_s' in [filter] was removed: leave it out: consistent fixes win when they are more than those "
        "that they contradict"
    )


def test_an_unknown_section_is_named_with_the_list_of_sections() -> None:
    assert message("[fliter]\n") == "x.toml: unknown section [fliter]; did you mean 'filter'? sections: filter, inputs"
    assert message("zzz = 1\n") == "x.toml: unknown section [zzz]; sections: filter, inputs"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[filter]\nhistory_s = "2"\n', 'filter.history_s = "2": expected float, got str'),
        ("[filter]\nhistory_s = true\n", "filter.history_s = true: expected float, got bool"),
        ("[filter]\nhistory_s = 0\n", "filter.history_s = 0: expected float > 0.0"),
        ("[filter]\nhistory_s = nan\n", "filter.history_s = nan: must be a finite number"),
        ("[filter]\nnoise = inf\n", "filter.noise = inf: must be a finite number"),
        ("[inputs]\norigin = [1.0, inf]\n", "inputs.origin[1] = inf: must be a finite number"),
        ("[inputs]\norigin = [1.0, 2.0, 3.0]\n", "inputs.origin = [1.0, 2.0, 3.0]: expected array of length 2, got 3"),
        ("[inputs]\nimu = [1]\n", "inputs.imu[0] = 1: expected str, got int"),
        ("inputs = 3\n", "inputs = 3: expected object, got int"),
        ('[filter]\naxes = "ned"\n', 'filter.axes = "ned": must be one of flu, frd'),
    ],
)
def test_a_wrong_value_is_named_with_its_path(text: str, expected: str) -> None:
    assert message(text) == f"x.toml: {expected}"


def test_text_that_is_no_toml_is_one_line() -> None:
    assert message("[filter\n").startswith("x.toml: not valid TOML: ")


def test_writing_and_reading_gives_the_same() -> None:
    settings = Settings(Filter(history_s=1e-7, axes="flu"), Inputs(imu=('/a "b"', "/ü"), origin=(1.0, -2.0)))
    assert decode(Settings, encode(settings), "x") == settings
    assert decode(Settings, encode(Settings()), "x") == Settings()


def test_the_table_of_keys_is_derived() -> None:
    assert keys(Settings) == [
        Key("filter", "history_s", "6.0", "s", "how late a measurement may come"),
        Key("filter", "noise", "0.1", "m/s", "white noise"),
        Key("filter", "axes", '"frd"', "", "axes"),
        Key("inputs", "imu", '["/imu"]', "", ""),
        Key("inputs", "origin", "-", "deg", "latitude, longitude"),
    ]
