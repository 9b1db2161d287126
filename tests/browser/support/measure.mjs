// Figures of a page and of a process.

import { readFile, readdir } from 'node:fs/promises';

/**
 * What a page holds: its scripts' objects, arrays, texts and buffers, and the nodes of its document, in bytes, from a snapshot of the heap. Without
 * code: what the engine compiles, throws away and compiles again is half of the heap, and comes and goes by a tenth of it.
 */
export async function heldBytes(page) {
  const session = await page.context().newCDPSession(page);
  const chunks = [];
  session.on('HeapProfiler.addHeapSnapshotChunk', ({ chunk }) => chunks.push(chunk));
  await session.send('HeapProfiler.collectGarbage');
  await session.send('HeapProfiler.takeHeapSnapshot');
  await session.detach();
  // Of V8's format: `nodes` are all fields of all nodes in one row, a type is a number of its table.
  const { snapshot: { meta }, nodes } = JSON.parse(chunks.join(''));
  const [type, size] = ['type', 'self_size'].map((field) => meta.node_fields.indexOf(field));
  const code = meta.node_types[type].indexOf('code');
  let held = 0;
  for (let at = 0; at < nodes.length; at += meta.node_fields.length) {
    if (nodes[at + type] !== code) held += nodes[at + size];
  }
  return held;
}

/** Animation frames of a page until its own clock has gone on by some milliseconds: how many a second, and how many took over 50 ms. */
export function frameRate(page, millis) {
  return page.evaluate((span_ms) => new Promise((resolve) => {
    const begun = performance.now();
    let last = begun;
    let frames = 0;
    let long = 0;
    const step = (now) => {
      frames += 1;
      if (now - last > 50) long += 1;
      last = now;
      if (now - begun < span_ms) requestAnimationFrame(step);
      else resolve({ per_s: (1000 * frames) / (now - begun), long });
    };
    requestAnimationFrame(step);
  }), millis);
}

/** Processor time of the threads of a process whose names begin so, in seconds; `names` are those that there are. */
export async function threadSeconds(pid, prefix) {
  let ticks = 0;
  const names = [];
  for (const thread of await readdir(`/proc/${pid}/task`)) {
    const stat = await readFile(`/proc/${pid}/task/${thread}/stat`, 'utf8').catch(() => null);
    if (stat === null) continue;
    // "PID (NAME) STATE ..": the name may hold blanks. utime and stime are fields 14 and 15, proc(5).
    const name = stat.slice(stat.indexOf('(') + 1, stat.lastIndexOf(')'));
    const fields = stat.slice(stat.lastIndexOf(')') + 2).split(' ');
    names.push(name);
    if (name.startsWith(prefix)) ticks += Number(fields[11]) + Number(fields[12]);
  }
  // Linux counts in hundredths of a second on every platform that Debian has (USER_HZ).
  return { seconds: ticks / 100, names };
}

/** Memory of a process that is in use, in bytes. */
export async function residentBytes(pid) {
  const status = await readFile(`/proc/${pid}/status`, 'utf8');
  return 1024 * Number(/^VmRSS:\s+(\d+) kB/m.exec(status)[1]);
}
