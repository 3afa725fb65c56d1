"""Keys that a TOML reader takes time and memory for."""

import time

import pytest

from models.untrusted import toml_text


@pytest.mark.parametrize("part", ["a", '"a"', "'a'"])
def test_a_dotted_key_of_many_parts_is_refused_before_it_is_read(part: str) -> None:
    text = " . ".join([part] * 100_000) + " = 1\n"
    began_s = time.process_time()
    with pytest.raises(ValueError, match=r"^not valid TOML: a key of more than 16 parts$"):
        toml_text.table(text)
    assert time.process_time() - began_s < 1.0


@pytest.mark.parametrize(
    ("text", "line"),
    [("/imu  2", "/imu  2"), ("a\x1b]0;b\x07c", "a ]0;b c"), ("a\nb", "a b"), ("\u202eg", "g"), ("a" * 400, "a" * 297 + "...")],
)
def test_one_line_has_no_control_characters(text: str, line: str) -> None:
    assert toml_text.one_line(text) == line


def test_dots_in_strings_comments_and_short_keys_are_no_parts() -> None:
    dots = ".".join("a" * 30)
    text = f'a.b.c = "{dots}"  # {dots}\nd = """\n{dots} = 1\n"""\n'
    assert toml_text.table(text) == {"a": {"b": {"c": dots}}, "d": f"{dots} = 1\n"}


def test_a_key_that_is_there_twice_is_said_so() -> None:
    with pytest.raises(ValueError, match=r"^not valid TOML: this key or section is there twice \(at line 2"):
        toml_text.table("a = 1\na = 2\n")
