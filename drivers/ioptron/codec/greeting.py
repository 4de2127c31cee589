"""Which iOptron mount answers: its model by its number, and its command set."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.ioptron.codec import v2, values
from drivers.ioptron.codec.dialect import CommandSet
from drivers.ioptron.codec.frames import signed_text
from drivers.ioptron.codec.v2 import V2
from drivers.ioptron.codec.v3 import V3
from drivers.wire.command import Command

# [IOPTRON310 :MountInfo#], and the later ones of INDI's ioptronv3driver
_V3 = {
    "0010": "SkyHunter EQ",
    "0011": "SkyHunter AA",
    "0012": "HAE16 EQ",
    "0013": "HAE16 AA",
    "0014": "HAE18 EQ",
    "0015": "HEM15",
    "0022": "HAE18 AA",
    "0025": "HEM27",
    "0026": "CEM26",
    "0027": "CEM26-EC",
    "0028": "GEM28",
    "0029": "GEM28-EC",
    "0030": "HEM27-EC",
    "0031": "HAE29 EQ",
    "0032": "HAE29-EC EQ",
    "0033": "HAE29 AA",
    "0034": "HAE29-EC AA",
    "0035": "HAZ31 AA",
    "0040": "CEM40(G)",
    "0041": "CEM40(G)-EC",
    "0043": "GEM45(G)",
    "0044": "GEM45(G)-EC",
    "0045": "HEM44-EC",
    "0048": "HAE43 EQ",
    "0049": "HAE43-EC EQ",
    "0050": "HAE43 AA",
    "0051": "HAE43-EC AA",
    "0052": "HAZ46 AA",
    "0060": "CEM60",
    "0061": "CEM60-EC",
    "0062": "HAE69 EQ",
    "0063": "HAE69-EC EQ",
    "0064": "HAE69 AA",
    "0065": "HAE69-EC AA",
    "0070": "CEM70(G)",
    "0071": "CEM70(G)-EC",
    "0072": "CEM70-EC2",
    "0073": "HAZ71 AA",
    "0120": "CEM120",
    "0121": "CEM120-EC",
    "0122": "CEM120-EC2",
    "5035": "AZ Mount Pro AA",
    "5045": "iEQ45 Pro AA",
}
# [INDI ieqdriverbase]
_V2 = {
    "0010": "Cube II EQ",
    "0011": "SmartEQ Pro+",
    "0025": "CEM25",
    "0026": "CEM25-EC",
    "0030": "iEQ30 Pro",
    "0040": "CEM40",
    "0041": "CEM40-EC",
    "0043": "GEM45",
    "0044": "GEM45-EC",
    "0045": "iEQ45 Pro EQ",
    "0046": "iEQ45 Pro AA",
    "0060": "CEM60",
    "0061": "CEM60-EC",
    "5010": "Cube II AA",
    "5035": "AZ Mount Pro AA",
    "5045": "iEQ45 Pro AA",
}
_NAMES = {"v3": _V3, "v2": _V2}
# `:MSH#` [IOPTRON310, INDI ieqdriverbase]
_SEARCH_HOME = {"v3": ("CEM120", "CEM70", "GEM45", "CEM40"), "v2": ("CEM60", "CEM40", "GEM45")}
_PARK = {"v3": ("",), "v2": ("CEM60", "CEM40", "GEM45", "iEQ")}


@dataclass(frozen=True, slots=True)
class Model:
    """What a model number means.

    Attributes
    ----------
    number : str
        Four digits.
    name : str
        Empty for an unknown one.
    searches_home : bool
        It has sensors at its home position.
    equatorial : bool
        Alt-azimuth mounts neither guide nor take a sync by right ascension and declination.
    """

    number: str
    name: str
    searches_home: bool
    parks: bool
    equatorial: bool


def model(number: str, dialect: str) -> Model:
    """Look a model up; one that is unknown is taken for an equatorial one without sensors."""
    name = _NAMES[dialect].get(number, "")
    return Model(
        number,
        name,
        name.startswith(_SEARCH_HOME[dialect]),
        not name or name.startswith(_PARK[dialect]),
        not name.endswith(" AA"),
    )


COMMAND_SETS: dict[str, CommandSet] = {words.name: words for words in (V3, V2)}


def _words(text: bytes) -> CommandSet:
    if len(text) == 23:
        values.status_from_text(text)
        return V3
    v2.status_from_text(text)
    return V2


GREETING: Command[CommandSet] = Command(
    b":GLS#", "site and status, in the words of either set", signed_text((19, 23), _words)
)
