// Elements in one call. Text goes in as text, never as markup: what a robot says is shown, not run.

/** @param {object} properties `class`, `text`, `on` (events), and attributes; false and null leave an attribute out. */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === 'class') made.className = value;
    else if (name === 'text') made.textContent = value;
    else if (name === 'on') for (const [event, listener] of Object.entries(value)) made.addEventListener(event, listener);
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value === true ? '' : String(value));
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

/** A box in which a table scrolls sideways by itself; the keyboard reaches it as well. */
export function scrolled(label, table) {
  return element('div', { class: 'scroll', role: 'region', tabindex: '0', 'aria-label': label }, table);
}

/** A button that does not submit. */
export function button(text, onClick, properties = {}) {
  return element('button', { type: 'button', text, on: { click: onClick }, ...properties });
}

/** Sets text only when it differs, so that an unchanged page costs no layout. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
