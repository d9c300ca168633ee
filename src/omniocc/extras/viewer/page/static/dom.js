// Elements of the page. Text is set as text, never as HTML, so names of scenes, runs and classes are inert.

export const at = id => document.getElementById(id);

// Return a new element with properties and children (elements or texts); `class`, `style` and `data-...`, `aria-...` and
// `role` are attributes.
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "style") Object.assign(element.style, value);
    else if (name === "class") element.className = value;
    else if (/^(data|aria)-|^(role|for)$/.test(name)) element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children);
  return element;
}

export const css = rgb => `rgb(${rgb.join(" ")})`;
export const swatch = rgb => make("i", { class: "swatch", style: { background: css(rgb) } });
export const number = (value, digits = 3) => (Number.isFinite(value) ? value.toFixed(digits) : "\u2013");
export const meters = value => (Number.isFinite(value) ? `${value.toFixed(2)} m` : "\u2013");
