"""Options that take all words up to the next option, as a shell's own `*.fits` gives them."""

from __future__ import annotations

from typing import Any, ClassVar

from typer.core import TyperCommand


class ManyValues(TyperCommand):
    """A command whose options named in `many` may be followed by several values: ``--dark a.fits b.fits``."""

    many: ClassVar[frozenset[str]] = frozenset({"--bias", "--dark", "--flat", "--flat-from-lights"})

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat the option's name before each of its values, then parse as usual."""
        spread: list[str] = []
        name, values = "", 0
        for word in args:
            if word.startswith("-") and len(word) > 1:
                name, values = (word if word in self.many else ""), 0
            elif name:
                if values:
                    spread.append(name)
                values += 1
            spread.append(word)
        return super().parse_args(ctx, spread)
