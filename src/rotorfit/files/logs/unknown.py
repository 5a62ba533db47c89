"""Files of no known format: what they are, by their first bytes, and what to try."""

_NUMPY = "save the arrays with scipy.io.savemat, or as CSV"

_MARKS = {
    b"\x1f\x8b": ("compressed with gzip", "unpack it"),
    b"BZh": ("compressed with bzip2", "unpack it"),
    b"\xfd7zXZ": ("compressed with xz", "unpack it"),
    b"7z\xbc\xaf": ("a 7-Zip archive", "unpack it"),
    b"PK\x03\x04": ("a zip archive, as .npz and .xlsx are", f"unpack it; {_NUMPY}"),
    b"\x93NUMPY": ("an array of NumPy", _NUMPY),
    b"{": ("JSON, but not one object a line with a number in it", "write each row with json.dumps"),
    b"[": ("JSON, but not one object a line with a number in it", "write each row with json.dumps"),
}


def told_unknown(head: bytes) -> str:
    """What a file of no known format is, and what to try."""
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    told = next((told for mark, told in _MARKS.items() if (start if mark in b"{[" else head).startswith(mark)), None)
    if told:
        return f"{told[0]}; {told[1]}"
    what = "of no known format; `rotorfit formats` lists what can be read"
    if b"\0" in head:
        return what
    return (
        f"{what}, and a CSV needs a header row of names in its first line, or below lines that begin with #, "
        "then rows of numbers between commas, semicolons or tabs"
    )
