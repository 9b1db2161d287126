// Which rows of a track stand for many: of each bucket of time the first one and those with the least and the most of some columns. Peaks stay.

/** Width of the buckets that divide a span: a power of two, so that a wider bucket is made of whole narrower ones. */
export function bucketWidth_s(span_s, buckets) {
  return 2 ** Math.ceil(Math.log2(Math.max(span_s, 1e-3) / Math.max(1, buckets)));
}

/** The rows of `from` to `to` that are kept, in their order. Buckets begin at multiples of their width, so that the choice does not depend on `from`. */
export function peakRows(columns, names, from, to, width_s) {
  const times = columns.t_s;
  const rows = [];
  let begin = from;
  while (begin < to) {
    const bucket = Math.floor(times[begin] / width_s);
    let end = begin + 1;
    while (end < to && Math.floor(times[end] / width_s) === bucket) end += 1;
    addPeaks(rows, columns, names, begin, end);
    begin = end;
  }
  return rows;
}

function addPeaks(rows, columns, names, begin, end) {
  if (end - begin === 1) {
    rows.push(begin);
    return;
  }
  const kept = [begin];
  for (const name of names) {
    const values = columns[name];
    let least = -1;
    let most = -1;
    for (let row = begin; row < end; row += 1) {
      if (Number.isNaN(values[row])) continue;
      if (least < 0 || values[row] < values[least]) least = row;
      if (most < 0 || values[row] > values[most]) most = row;
    }
    for (const row of [least, most]) if (row >= 0 && !kept.includes(row)) kept.push(row);
  }
  rows.push(...kept.sort((one, other) => one - other));
}
