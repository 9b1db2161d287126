// What axe-core finds on a page, by the rules of WCAG 2.2 AA and its best practices.

import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';

const SOURCE = createRequire(import.meta.url).resolve('axe-core/axe.min.js');
const TAGS = ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'];

/** One line for each element that breaks a rule. */
export async function findings(page) {
  const session = await page.context().newCDPSession(page);
  // As the browser's own tools do it: the page's policy allows no scripts but its own.
  await session.send('Runtime.evaluate', { expression: await readFile(SOURCE, 'utf8') });
  await session.detach();
  return page.evaluate(async (tags) => {
    const { violations } = await globalThis.axe.run(document, { runOnly: tags, rules: { 'target-size': { enabled: true } }, resultTypes: ['violations'] });
    return violations.flatMap(({ id, help, nodes }) => nodes.map(({ html, any, all }) => `${id} (${help}): ${html.slice(0, 160)} ${[...any, ...all].map(({ message }) => message).join(' ').slice(0, 160)}`));
  }, TAGS);
}
