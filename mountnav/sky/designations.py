"""Stars' designations as people write them: Greek letters and constellations, brought to one form.

``α Lyr``, ``alf Lyr``, ``Alpha Lyrae`` and ``alpha lyr`` are one: name of the letter, number, and the three
letters that the IAU has for the constellation.
"""

from __future__ import annotations

import re

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


__all__ = ["GREEK", "in_one_form"]
