// Before the first paint: who left the page red finds it red, with no flash of white letters while the rest is loaded.

(() => {
  try {
    if (!localStorage.getItem("mountnav-night")) return;
  } catch {
    return; // a browser that keeps nothing
  }
  document.documentElement.dataset.night = "";
  document.querySelector("meta[name=theme-color]").content = "#000000";
})();
