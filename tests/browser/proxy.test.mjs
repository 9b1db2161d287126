// TLS by the recipe of docs/dashboard.md: HAProxy with the files of contrib/proxy in front of the page, and at both ends of a TCP link.

import assert from 'node:assert/strict';
import { execFile, spawn } from 'node:child_process';
import { chmod, readFile, rename, writeFile } from 'node:fs/promises';
import https from 'node:https';
import net from 'node:net';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { promisify } from 'node:util';
import { Browser } from './support/browser.mjs';
import { waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';

const NAME = 'robots.example.org';
const HAPROXY = process.env.HAPROXY ?? '/usr/sbin/haproxy';
const CONFIGURATION = `
[dashboard]
listen = "127.0.0.1:0"
public_names = ["${NAME}"]
token_file = "tokens"
[[link]]
url = "tcp://127.0.0.1:0"
listen = true
`;

const ended = [];
let folder;
let station;
let browser;
let ports;

before(async () => {
  folder = await newFolder();
  const file = (name) => path.join(folder, name);
  await promisify(execFile)('openssl', ['req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256', '-nodes', '-days', '825',
    '-subj', `/CN=${NAME}`, '-addext', `subjectAltName=DNS:${NAME}`, '-keyout', file('key.pem'), '-out', file('cert.pem')]);
  await writeFile(file('station.pem'), await readFile(file('cert.pem')) + await readFile(file('key.pem')));
  await writeFile(file('station.toml'), CONFIGURATION);
  station = Program.start(['run', '--config', 'station.toml'], folder);
  const page = new URL(await station.address()).host;
  const [, link] = await station.finds(/listening on (127\.0\.0\.1:\d+)/);
  const shared = { POSEBRIDGE_PEM: file('station.pem'), PAGE_STATION: page, LINK_STATION: link };
  const [pagePort, linkPort] = await proxy('station.cfg', ['PAGE_BIND', 'LINK_BIND'], shared);
  const [robotPort] = await proxy('robot.cfg', ['ROBOT_BIND'], { LINK_ADDRESS: `127.0.0.1:${linkPort}`, POSEBRIDGE_CA: file('cert.pem'), STATION_NAME: NAME });
  ports = { page: pagePort, link: linkPort, robot: robotPort };
  browser = await Browser.launch({ further: [`--host-resolver-rules=MAP ${NAME} 127.0.0.1`], ignoreHTTPSErrors: true });
});

after(async () => {
  await browser?.close();
  for (const end of ended) await end();
  await station?.remove();
});

// Starts HAProxy with a file of contrib/proxy, listening at free ports; gives them.
async function proxy(file, binds, environment) {
  const servers = await Promise.all(binds.map(async () => {
    const server = net.createServer().listen(0, '127.0.0.1');
    await new Promise((resolve) => server.once('listening', resolve));
    return server;
  }));
  const found = servers.map((server) => server.address().port);
  const names = Object.fromEntries(binds.map((name, index) => [name, `fd@${3 + index}`]));
  const config = path.join(process.env.BROWSER_ROOT, 'contrib/proxy', file);
  const stdio = ['ignore', 'inherit', 'inherit', ...servers.map((server) => server._handle.fd)];
  const child = spawn(HAPROXY, ['-db', '-f', config], { env: { ...process.env, ...environment, ...names }, stdio });
  const exited = new Promise((resolve) => { child.once('close', resolve); });
  ended.push(() => { child.kill('SIGKILL'); return exited; });
  // The sockets live on in the other process.
  for (const server of servers) server.close();
  return found;
}

async function tokens() {
  const text = await readFile(path.join(folder, 'tokens'), 'utf8');
  return { text, operator: /^operator (\S+)/m.exec(text)[1], reader: /^reader (\S+)/m.exec(text)[1] };
}

// The status and the text of an answer through the proxy, whose certificate is checked.
async function ask(where, headers = {}) {
  const ca = await readFile(path.join(folder, 'cert.pem'));
  const options = { host: '127.0.0.1', port: ports.page, servername: NAME, ca, path: where, headers: { host: NAME, ...headers } };
  return new Promise((resolve, reject) => {
    https.get(options, async (response) => {
      let text = '';
      for await (const bytes of response) text += bytes;
      resolve({ status: response.statusCode, headers: response.headers, text });
    }).once('error', reject);
  });
}

test('through the proxy a request needs a token, and a cookie stays on TLS', async () => {
  const { operator } = await tokens();
  assert.equal((await ask('/v1/robots')).status, 401);
  assert.equal((await ask('/v1/robots', { authorization: `Bearer ${operator}` })).status, 200);
  assert.equal((await ask('/v1/robots', { host: 'evil.example', authorization: `Bearer ${operator}` })).status, 421);
  const opened = await ask(`/?token=${operator}`);
  assert.match(opened.headers['set-cookie'][0], /; HttpOnly; SameSite=Strict; Secure$/);
});

test('a robot whose link is encrypted at both ends is seen on the page, and gets estimates', async () => {
  const { reader } = await tokens();
  const robot = Program.start(['sim', 'square', '--link', `tcp://127.0.0.1:${ports.robot}`, '--steer', 'estimate'], await newFolder());
  ended.push(() => robot.remove());
  const page = await browser.open(`https://${NAME}:${ports.page}/?token=${reader}`, { forgives: ['401', 'WebSocket'] });
  await waitForState(page, 'live');
  await page.waitForFunction(() => Number(document.getElementById('pose').dataset.t_s) > 2);
  // The robot's link is the first: what the station sends back goes through both proxies. Its rate is that of the second before.
  let link;
  do ({ links: [link] } = JSON.parse((await ask('/v1/state', { authorization: `Bearer ${reader}` })).text)); while (!(link.frames_in_per_s > 10));

  // Somebody who may only look, until the token is taken away.
  await page.locator('#parameters .note').getByText('Your token only lets you look.').waitFor({ state: 'attached' });
  const file = path.join(folder, 'tokens');
  await writeFile(`${file}.new`, (await tokens()).text.replace(/^reader .*\n/m, ''));
  await chmod(`${file}.new`, 0o600);
  await rename(`${file}.new`, file);
  await waitForState(page, 'refused');
});
