// Light or dark: as the system says, until somebody chooses; the choice is remembered.

const KEY = 'posebridge-theme';
const system = globalThis.matchMedia('(prefers-color-scheme: dark)');

/** Follows system and button; calls `onChange` after each change. */
export function followTheme(toggle, onChange) {
  const show = () => {
    const theme = chosen() ?? (system.matches ? 'dark' : 'light');
    document.documentElement.dataset.theme = theme;
    toggle.textContent = theme === 'dark' ? 'Light' : 'Dark';
    toggle.setAttribute('aria-label', theme === 'dark' ? 'Change to light colours' : 'Change to dark colours');
    onChange();
  };
  toggle.addEventListener('click', () => {
    remember(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark');
    show();
  });
  system.addEventListener('change', show);
  show();
}

// A browser may refuse storage; then the choice lasts as long as the page.
let here = null;

function chosen() {
  try {
    return localStorage.getItem(KEY) ?? here;
  } catch {
    return here;
  }
}

function remember(theme) {
  here = theme;
  try {
    localStorage.setItem(KEY, theme);
  } catch {
    return;
  }
}
