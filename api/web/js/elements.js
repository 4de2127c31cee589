// Making elements, drawing on canvases that follow their size, colors of the present mode.

export const by = (id) => document.getElementById(id);

/** An element with properties and children; text is always text. */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null || value === false) continue;
    if (name === "class") made.className = value;
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.filter((one) => one !== null && one !== undefined));
  return made;
}

export function fill(parent, ...children) {
  parent.replaceChildren(...children.filter((one) => one !== null && one !== undefined));
}

/** Set text only if it differs: screen readers speak again of what is set again. */
export function say(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/** The colors of the style sheet, by name, as they are now. */
export function colors() {
  const style = getComputedStyle(document.documentElement);
  return new Proxy({}, { get: (_, name) => style.getPropertyValue(`--${String(name)}`).trim() });
}

const canvases = [];

/** Keep a canvas drawn: `draw(context, width, height, colors)` in CSS pixels, again when its size or the mode changes. */
export function drawn(canvas, draw) {
  let waiting = false;
  function now() {
    waiting = false;
    const { width, height } = canvas.getBoundingClientRect();
    if (width < 2 || height < 2) return;
    const ratio = window.devicePixelRatio || 1;
    const w = Math.round(width * ratio), h = Math.round(height * ratio);
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    draw(context, width, height, colors());
  }
  function again() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(now);
  }
  new ResizeObserver(again).observe(canvas);
  canvases.push(again);
  return again;
}

/** Draw everything anew: the mode has changed. */
export const redraw = () => canvases.forEach((again) => again());

export const MONO = '11px ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace';
