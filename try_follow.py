import sys
from datetime import timedelta
from mountnav.ephemeris import SkyRatesTarget
from mountnav.simulation.rate_faults import RateFault
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.rated_mount import RatedMount
from tests.navigation.virtual_rig import in_virtual_time, SITE
import asyncio
ra,dec,minutes=map(float,sys.argv[1:4])
fault = eval("RateFault(%s)"%sys.argv[4]) if len(sys.argv)>4 else None
async def work(rig):
    if fault: rig.mechanics.fail_rates(fault)
    t=SkyRatesTarget(rig.up(-30.,30.),ra,dec,rig.clock.utc(),rig.clock.utc()+timedelta(hours=2),"mover")
    offs=[]
    def heard(p):
        print(f"{p.utc:%H:%M:%S} {p.phase} {p.by} {p.off_arcsec} sent={p.sent and (round(p.sent.ra_arcsec_s,3),round(p.sent.dec_arcsec_s,3))} {p.words}")
    async def watch():
        while True:
            await rig.clock.sleep(5.0)
            offs.append((rig.clock.utc(), separation_arcsec(rig.mechanics.truth(rig.clock.utc()), t.icrs(rig.clock.utc(),SITE))))
    w=asyncio.create_task(watch())
    try:
        r=await rig.navigator.follow(t, until_utc=rig.clock.utc()+timedelta(minutes=minutes), tolerance_arcsec=5.0, heard=heard)
    finally:
        w.cancel()
        print([round(o,1) for u,o in offs][-60:])
        print("rates left", rig.mechanics.beside_arcsec_s, rig.navigator.rates.words)
    print(r.end, r.by, r.looks, r.unsolved, r.worst_arcsec, r.rms_arcsec, r.within, r.renewed, r.fault, r.correction); print("\n".join(r.notes))
in_virtual_time(work, made=RatedMount)
