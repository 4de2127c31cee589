"""Bodies of requests: multipart as clients really write it, in pieces of any size; and what is none."""

from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.nova.codec import NovaError
from api.nova.forms import Form, Multipart, boundary_of, read_urlencoded
from tests.api.nova.nova_service import raw_form

BOUNDARY = "===============1234567890=="
JSON = b'{"session": "abc"}'


def parts(content: bytes, filename: str = "a.fits") -> list[tuple[str, str, bytes]]:
    return [
        ("", 'form-data; name="request-json"', JSON),
        ("Content-Type: x/y\r\n", f'form-data; name="file"; filename="{filename}"', content),
    ]


def fed(body: bytes, sizes: list[int] | None = None, most_bytes: int = 10**6) -> Form:
    """The form of a body that comes in pieces of these sizes, the last one again and again."""
    reader = Multipart(BOUNDARY.encode(), most_bytes)
    left = [*(sizes or [len(body) + 1])]
    try:
        while body:
            size = left.pop(0) if len(left) > 1 else left[0]
            reader.feed(body[:size])
            body = body[size:]
        return reader.finish()
    except NovaError:
        reader.form.close()
        raise


def content_of(form: Form) -> bytes:
    assert form.file is not None
    form.file.seek(0)
    content = form.file.read()
    form.close()
    return content


@given(
    st.binary(max_size=300).filter(lambda one: not one.endswith(b"\r")),
    st.lists(st.integers(1, 90), min_size=1, max_size=20),
    st.sampled_from(["\r\n", "\n"]),
)
def test_any_file_in_any_pieces(content: bytes, sizes: list[int], line_end: str) -> None:
    """Lines of boundaries end by CR LF, or by LF alone as client.py's."""
    form = fed(raw_form(parts(content), BOUNDARY, line_end), sizes)
    assert (form.json, form.name, form.size) == (JSON, "a.fits", len(content))
    assert form.sha256 == hashlib.sha256(content).hexdigest()
    assert content_of(form) == content


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"--",
        f"--{BOUNDARY}".encode(),
        f"\r\n--{BOUNDARY[:-1]}".encode(),
        f"\r\n-{BOUNDARY}\r\n".encode() * 50,
        b"\n" * 1000,
        b"\r\n\r\n",
    ],
)
def test_contents_that_look_like_boundaries(content: bytes) -> None:
    for size in (1, 7, 10_000):
        assert content_of(fed(raw_form(parts(content), BOUNDARY, "\r\n"), [size])) == content


def test_names_of_files_lose_their_folders_and_odd_characters() -> None:
    for given_name, name in (
        ("/tmp/a b.fits", "a b.fits"),
        ("C:\\\\Users\\\\me\\\\b.fits", "b.fits"),
        ("../../etc/passwd", "passwd"),
        ("a\x01\x1b[31m.fits", "a__[31m.fits"),
        ("x" * 500, "x" * 100),
        ("", "upload"),
    ):
        form = fed(raw_form(parts(b"x", given_name), BOUNDARY, "\r\n"))
        form.close()
        assert form.name == name


def test_no_form_is_refused() -> None:
    whole = raw_form(parts(b"content"), BOUNDARY, "\r\n")
    two_files = raw_form([*parts(b"1"), *parts(b"2")], BOUNDARY, "\r\n")
    many = raw_form([("", 'form-data; name="other"', b"x")] * 1000, BOUNDARY, "\r\n")
    long_head = raw_form([("X: " + "y" * 100_000 + "\r\n", 'form-data; name="file"', b"x")], BOUNDARY, "\r\n")
    malformed = whole.replace(b"\r\nContent-disposition", b" trailing\r\nContent-disposition", 1)
    for body, words in (
        (b"", "cut short"),
        (b"garbage" * 1000, "cut short"),
        (whole[:-10], "cut short"),
        (whole[: len(whole) // 2], "cut short"),
        (two_files, "more than one file"),
        (many, "parts"),
        (long_head, "too long"),
        (malformed, "malformed"),
        (b"--" + BOUNDARY.encode() + b"x" * 1000, "malformed"),
    ):
        with pytest.raises(NovaError, match=words):
            fed(body, [1000])


def test_what_is_too_large_is_refused_as_soon_as_it_shows() -> None:
    body = raw_form(parts(b"x" * 2000), BOUNDARY, "\r\n")
    with pytest.raises(NovaError) as refused:
        fed(body, [100], most_bytes=1000)
    assert refused.value.status == 413
    with pytest.raises(NovaError) as refused:
        fed(raw_form([("", 'form-data; name="request-json"', b" " * 3_000_000)], BOUNDARY, "\r\n"), [65536])
    assert refused.value.status == 413


def test_boundaries_in_all_the_ways_that_clients_write_them() -> None:
    for kind in (
        f'multipart/form-data; boundary="{BOUNDARY}"',
        f"multipart/form-data;boundary={BOUNDARY}",
        f"Multipart/Form-Data; charset=utf-8; Boundary={BOUNDARY}",
    ):
        assert boundary_of(kind) == BOUNDARY.encode()
    assert boundary_of("application/x-www-form-urlencoded") is None
    assert boundary_of("") is None
    for kind in (
        "multipart/form-data",
        "multipart/form-data; boundary=",
        f"multipart/x; boundary={'b' * 999}",
    ):
        with pytest.raises(NovaError, match="boundary"):
            boundary_of(kind)


def test_url_encoded_forms() -> None:
    assert read_urlencoded(b"request-json=%7B%22a%22%3A1%7D").json == b'{"a":1}'
    assert read_urlencoded(b'request-json={"apikey":"a-b_c"}').json == b'{"apikey":"a-b_c"}'
    assert read_urlencoded(b"other=1").json is None
    for body in (b"&".join(b"a=1" for _ in range(1000)), b"request-json=\xff"):
        with pytest.raises(NovaError):
            read_urlencoded(body)
