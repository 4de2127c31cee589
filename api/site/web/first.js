// Before the first paint: who left the page red finds it red, with no flash of white letters while the rest is loaded.

(() => {
  try {
    if (!localStorage.getItem("mountnav-night")) return;
  } catch {
    return; // a browser that keeps nothing
  }
  document.documentElement.dataset.night = "";
  const bar = document.querySelector("meta[name=theme-color]");
  if (bar) bar.content = "#000000"; // the description of the API has none
})();
