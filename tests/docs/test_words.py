"""The tool that counts the words of the docs tells prose from tables, and leaves code out."""

from __future__ import annotations

import subprocess
import sys

from tests.docs.walk import ROOT


def test_prose_tables_and_code_are_told_apart() -> None:
    text = "Two words.\n\n| a | 0.5 px |\n|---|---|\n\n```sh\nnot counted at all\n```\n"
    ran = subprocess.run(
        [sys.executable, "-c", f"import docs_words; print(docs_words.counted({text!r}))"],
        cwd=ROOT / "tools",
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout == "(2, 3)\n"
