// What the headline says of known and unknown figures; run in the page.
async () => {
  const { headlineParts, restWords } = await import('/web/js/headline.js');
  const { placesIn, degrees, hours } = await import('/web/js/angles.js');
  const times = { sun_sets_utc: '2026-11-26T15:32:00Z', dark_from_utc: '2026-11-26T17:20:00Z', dark_until_utc: '2026-11-27T04:46:00Z', sun_rises_utc: '2026-11-27T06:34:00Z' };
  const headline = { target: 'Vega', arrived: true, error_arcsec: 2.04, error_utc: '2026-11-26T23:59:30Z', fwhm_arcsec: 3.1,
    fwhm_utc: '2026-11-26T23:30:00Z', meridian_s: 10080, times };
  const sky = { utc: '2026-11-27T00:00:00Z', altitude_deg: 61.25, headline }, up = { connected: true };
  const words = (one, state) => headlineParts(one, state).parts.map((each) => each.text).join(' | ');
  return {
    known: [headlineParts(sky, up).target, words(sky, up)],
    unknown: words({ ...sky, altitude_deg: null, headline: { ...headline, error_arcsec: null, error_utc: null, fwhm_arcsec: null, meridian_s: null, times: {} } }, up),
    past: words({ ...sky, headline: { ...headline, meridian_s: -4320 } }, up),
    away: headlineParts(sky, { connected: false }),
    rest: [restWords({ connected: true, slewing: false, tracking: false, still_since_utc: '2026-11-26T21:32:10.4Z' }),
      restWords({ connected: true, slewing: true, tracking: false, still_since_utc: null }), restWords({ connected: true, slewing: false, still_since_utc: null })],
    places: placesIn('seen at RA 240.6621° Dec +51.9097°: 37 stars, then RA 0.0001° Dec -5.5000°'),
    angles: [degrees(-0.04), degrees(-12.34), degrees(null), hours(10080), hours(2880), hours(59)],
  };
}
