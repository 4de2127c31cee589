"""Positions by name: bright stars, Messier's objects, planets and Moon; a bundled list and formulas.

Stars' designations as people write them: Greek letters and constellations, brought to one form.

``α Lyr``, ``alf Lyr``, ``Alpha Lyrae`` and ``alpha lyr`` are one: name of the letter, number, and the three
letters that the IAU has for the constellation.
"""

from __future__ import annotations

import csv
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Literal

from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.planets import BODIES, position_of_body
from mountnav.sky.proper_motion import moved_to

__all__ = [
    "GREEK",
    "NamedObject",
    "in_one_form",
    "name_key",
    "named_objects",
    "object_of_name",
    "position_of_name",
    "search",
]


_LETTERS = """alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho sigma
tau upsilon phi chi psi omega"""
GREEK = dict(zip("αβγδεζηθικλμνξοπρστυφχψω", re.findall(r"\w+", _LETTERS), strict=True))
"""Names of the Greek letters."""

# as SIMBAD and the Bright Star Catalogue shorten them
_SHORTENED = """alf=alpha alp=alpha bet=beta gam=gamma del=delta eps=epsilon zet=zeta tet=theta the=theta
iot=iota kap=kappa lam=lambda ksi=xi omi=omicron sig=sigma ups=upsilon ome=omega"""
_SHORT: dict[str, str] = dict(re.findall(r"(\w+)=(\w+)", _SHORTENED))

# the IAU's letters, then the genitive
_GENITIVES = """and=andromedae ant=antliae aps=apodis aql=aquilae aqr=aquarii ara=arae ari=arietis aur=aurigae
boo=bootis cae=caeli cam=camelopardalis cap=capricorni car=carinae cas=cassiopeiae cen=centauri cep=cephei
cet=ceti cha=chamaeleontis cir=circini cma=canismajoris cmi=canisminoris cnc=cancri col=columbae
com=comaeberenices cra=coronaeaustralis crb=coronaeborealis crt=crateris cru=crucis crv=corvi
cvn=canumvenaticorum cyg=cygni del=delphini dor=doradus dra=draconis equ=equulei eri=eridani for=fornacis
gem=geminorum gru=gruis her=herculis hor=horologii hya=hydrae hyi=hydri ind=indi lac=lacertae leo=leonis
lep=leporis lib=librae lmi=leonisminoris lup=lupi lyn=lyncis lyr=lyrae men=mensae mic=microscopii
mon=monocerotis mus=muscae nor=normae oct=octantis oph=ophiuchi ori=orionis pav=pavonis peg=pegasi per=persei
phe=phoenicis pic=pictoris psa=piscisaustrini psc=piscium pup=puppis pyx=pyxidis ret=reticuli scl=sculptoris
sco=scorpii sct=scuti ser=serpentis sex=sextantis sge=sagittae sgr=sagittarii tau=tauri tel=telescopii
tra=trianguliaustralis tri=trianguli tuc=tucanae uma=ursaemajoris umi=ursaeminoris vel=velorum vir=virginis
vol=volantis vul=vulpeculae"""
_CONSTELLATIONS: dict[str, str] = {
    written: letters
    for letters, genitive in re.findall(r"(\w+)=(\w+)", _GENITIVES)
    for written in (letters, genitive)
}

_DESIGNATION = re.compile(f"({'|'.join((*GREEK.values(), *_SHORT))}|)([0-9]*)({'|'.join(_CONSTELLATIONS)})")


def in_one_form(key: str) -> str:
    """A designation in its one form; what is none stays as it is.

    Parameters
    ----------
    key : str
        Small letters and digits, no blanks, Greek letters spelled out: ``alphalyrae``.

    Returns
    -------
    str
        Such as ``alphalyr``; ``80uma`` of ``80ursaemajoris``.
    """
    found = _DESIGNATION.fullmatch(key)
    if found is None:
        return key
    letter, number, constellation = map(str, found.groups())
    if not letter and not number:
        return key
    return _SHORT.get(letter, letter) + number + _CONSTELLATIONS[constellation]


OBJECTS_PATH = Path(__file__).parent / "data" / "named_objects.csv"

Kind = Literal["star", "messier", "planet", "moon", "sun"]

_NO_PART_OF_A_NAME = frozenset(("Mn", "Pd", "Pc", "Pi", "Pf", "Ps", "Pe", "Zs", "Cc", "Cf", "Lm", "Sk"))
"""Unicode's categories of accents, dashes, quotes, brackets, blanks, and of what can't be seen."""
_MARKS = frozenset("'\".,·*")
_LEADING_ZEROS = re.compile(r"(?<![0-9.,])0+(?=[0-9])")


@dataclass(frozen=True, slots=True)
class NamedObject:
    """Something bright that has a name.

    Attributes
    ----------
    aliases : tuple of str
        Other names and designations.
    mag : float or None
        Visual; None where it changes.
    place : Icrs or None
        At `epoch_yr`; None for what wanders.
    """

    name: str
    kind: Kind
    aliases: tuple[str, ...] = ()
    mag: float | None = None
    place: Icrs | None = None
    epoch_yr: float = 2000.0
    pm_ra_cosdec_masyr: float = 0.0
    pm_dec_masyr: float = 0.0
    parallax_mas: float = 0.0

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it is at `utc`, seen from a site. Raises `BadRequest` for an instant outside 1972 to 2099."""
        if self.place is None:
            return position_of_body(self.name.lower(), utc, site)
        return moved_to(
            self.place,
            utc,
            epoch_yr=self.epoch_yr,
            pm_ra_cosdec_masyr=self.pm_ra_cosdec_masyr,
            pm_dec_masyr=self.pm_dec_masyr,
            parallax_mas=self.parallax_mas,
        )


@cache
def named_objects() -> tuple[NamedObject, ...]:
    """All that have a name: the bodies of the solar system, then the stars, then Messier's."""
    return (*_bodies(), *_listed())


def object_of_name(name: str) -> NamedObject:
    """Find the object of a name or designation; case, blanks, dashes, quotes and accents don't count.

    Letters and constellations may be spelled out or shortened: ``α Lyr``, ``alf Lyr``, ``Alpha Lyrae``.

    Raises
    ------
    BadRequest
        There is none; the advice tells what is called alike.
    """
    found = _by_key().get(name_key(name))
    if found is None:
        like = ", ".join(one.name for one in search(name, 3)) if name_key(name) else ""
        raise BadRequest(
            f"nothing here is called {name!r}",
            advice=f"is it one of these: {like}?" if like else "GET /v1/objects?q= finds names",
        )
    return found


def position_of_name(name: str, utc: datetime, site: Site) -> Icrs:
    """Where an object of that name is, as seen from the site.

    Raises
    ------
    BadRequest
        There is none of that name; or the instant is outside 1972 to 2099.
    """
    return object_of_name(name).icrs(utc, site)


def search(text: str, count: int = 20) -> list[NamedObject]:
    """Objects whose names hold a text: that name itself, then those that begin so, then the brighter ones.

    Parameters
    ----------
    text : str
        Nothing: the brightest of all, the Sun left out.
    count : int
        At most so many.
    """
    wanted = name_key(text)
    ranked: list[tuple[int, float, str, NamedObject]] = []
    for one in named_objects():
        keys = _keys_of(one)
        if wanted in keys:
            rank = 0
        elif wanted and any(key.startswith(wanted) for key in keys):
            rank = 1
        elif any(wanted in key for key in keys):
            rank = 2
        else:
            continue
        if not wanted and one.kind == "sun":
            continue
        ranked.append((rank, -99.0 if one.mag is None else one.mag, one.name, one))
    return [one for *_, one in sorted(ranked, key=lambda row: row[:3])[:count]]


def _bodies() -> Iterator[NamedObject]:
    for name in BODIES:
        kind: Kind = "sun" if name == "sun" else "moon" if name == "moon" else "planet"
        yield NamedObject(name.capitalize(), kind)


def _listed() -> Iterator[NamedObject]:
    with OBJECTS_PATH.open(encoding="utf-8", newline="") as lines:
        for row in csv.DictReader(line for line in lines if not line.startswith("#")):
            yield NamedObject(
                row["name"],
                "star" if row["kind"] == "star" else "messier",
                tuple(row["aliases"].split(";")),
                float(row["mag"]),
                Icrs(float(row["ra_deg"]), float(row["dec_deg"])),
                float(row["epoch_yr"]),
                float(row["pm_ra_cosdec_masyr"]),
                float(row["pm_dec_masyr"]),
                float(row["parallax_mas"]),
            )


@cache
def _by_key() -> dict[str, NamedObject]:
    """Each name and designation with its object; of those that share a designation the brightest."""
    found: dict[str, NamedObject] = {}
    for one in sorted(named_objects(), key=lambda one: -99.0 if one.mag is None else one.mag):
        for key in _keys_of(one):
            found.setdefault(key, one)
    # a proper name goes before any designation
    return found | {name_key(one.name): one for one in named_objects()}


@cache
def _keys_of(one: NamedObject) -> tuple[str, ...]:
    return tuple(name_key(name) for name in (one.name, *one.aliases))


def name_key(text: str) -> str:
    """A name as it is compared: letters small, without accents, Greek ones spelled out; digits as they are.

    What might be part of a number (``M4.0`` is not M40) or of another script stays: it is nobody's name here.
    """
    plain = unicodedata.normalize("NFKD", unicodedata.normalize("NFKD", text).casefold())
    parts = []
    for before, letter, after in zip(f" {plain}", plain, f"{plain[1:]} ", strict=False):
        in_number = letter in ".," and before.isdecimal() and after.isdecimal()
        if letter.isdecimal():
            parts.append(str(unicodedata.decimal(letter)))
        elif in_number or not (letter in _MARKS or unicodedata.category(letter) in _NO_PART_OF_A_NAME):
            parts.append(GREEK.get(letter, letter))
    return in_one_form(_LEADING_ZEROS.sub("", "".join(parts)))
