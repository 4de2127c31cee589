// The description of the API: dark where the system is, or where the page is red; and as soon as that changes.

(() => {
  const root = document.documentElement;
  const dark = matchMedia("(prefers-color-scheme: dark)");

  const draw = () => {
    // the theme that Swagger UI brings along
    root.classList.toggle("dark-mode", dark.matches || "night" in root.dataset);
  };

  dark.addEventListener("change", draw);
  addEventListener("storage", (event) => {
    if (event.key !== null && event.key !== "mountnav-night") return;
    if (event.newValue) root.dataset.night = "";
    else delete root.dataset.night;
    draw();
  });
  draw();
})();
