"""Solve a strange picture"""
# %% [markdown]
# A picture without a header: somebody mirrored it, turned it, stretched its contrast, wrote a caption into
# it and saved it as JPEG. Neither the place nor the scale is known.

# %%
import io
from datetime import UTC, datetime

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image, ImageDraw

import mountnav as mn
from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame

camera = SimulatedOptics(1100, 900, 6.3, rotation_deg=203.0, parity=-1, fwhm_px=3.2, faint_stars_deg2=200.0)
secret = mn.Icrs(83.05, -1.2)  # the belt of Orion
frame = draw_frame(
    secret,
    camera,
    embedded_catalog(),
    exposure_s=20,
    mid_exposure_utc=datetime(2026, 1, 20, 21, tzinfo=UTC),
    seed=5,
)
sky, noise = np.median(frame.pixels), np.std(frame.pixels[frame.pixels < np.percentile(frame.pixels, 90)])
stretched = np.arcsinh(np.clip((frame.pixels - sky) / noise + 2, 0, None) / 6)
grey = Image.fromarray((255 * np.clip(stretched / stretched.max() * 1.3, 0, 1)).astype(np.uint8)[::-1])
ImageDraw.Draw(grey).text((30, 850), "my best night ever!", fill=255)
jpeg = io.BytesIO()
grey.save(jpeg, "jpeg", quality=80)
print(f"{len(jpeg.getvalue()) // 1000} kB of JPEG, no header")

# %%
figure, axes = plt.subplots(figsize=(7, 5.5), num="The picture")
axes.imshow(grey, cmap="gray")
axes.axis("off")

# %% [markdown]
# `mn.read` takes bytes of any kind of picture as a file does. With `blind` (the default) the whole sky is
# searched, by an index that is built once per machine.

# %%
from pathlib import Path
from tempfile import TemporaryDirectory

with TemporaryDirectory() as folder:
    picture = Path(folder) / "orion.jpg"
    picture.write_bytes(jpeg.getvalue())
    solved = mn.solve(picture)
print(solved.center.to_string("hmsdms", precision=0))
print(f"scale {solved.scale_arcsec_px:.2f} ″/px, {solved.solution.pairs} stars")
print(f"a wrong place would look as good with a probability below 1e-9: {solved.false_probability < 1e-9}")

# %%
axes = solved.plot()
axes.figure.set_label("The picture with the stars that were identified")
apart = np.hypot(
    (solved.center.ra.deg - secret.ra_deg) * np.cos(np.radians(secret.dec_deg)),
    solved.center.dec.deg - secret.dec_deg,
)
assert apart * 3600 < 5.0, "the place is right"

# %% [markdown]
# ## What is refused
#
# The same picture, cut into tiles that are put together in another order, still shows stars, and no place
# in the sky. It is refused with a reason; nothing is guessed.

# %%
tiles = [np.asarray(grey)[y : y + 300, x : x + 275] for y in range(0, 900, 300) for x in range(0, 1100, 275)]
random = np.random.default_rng(3)
order = random.permutation(len(tiles))
rows = [
    np.hstack([np.rot90(tiles[k][:275, :275], k) for k in order[4 * row : 4 * row + 4]]) for row in range(3)
]
puzzle = np.vstack(rows)
try:
    mn.solve(puzzle.astype(float))
    print("solved")
except mn.SolveFailed as refused:
    print("refused:", refused.reason)
