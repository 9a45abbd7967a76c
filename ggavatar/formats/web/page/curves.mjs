// Recordings of ARKit's scores: Live Link Face CSV and JSON with names and weights. Columns are found by name, since
// programs order the 52 differently.

const MOST_BYTES = 32 * 1024 * 1024;
const MOST_ROWS = 100000;
const LEAST_NAMES = 20; // fewer are some other table
const USUAL_RATE = 30; // frames per second, of recordings without times
const TIME_CODE = /^(\d{1,2}):(\d{1,2}):(\d{1,2})[:;](\d{1,3}(?:\.\d+)?)$/;

export class Unreadable extends Error {}

// {fps, frames: [{name: score}]} at an even rate, from the text of a file; `known` are the names that can be used.
export function readCurves(text, known) {
  if (text.length > MOST_BYTES) throw new Unreadable("it is larger than 32 MB");
  const table = /^[\s\uFEFF]*[{[]/.test(text) ? jsonTable(text) : csvTable(text);
  const columns = matched(table.names, known);
  if (columns.length < Math.min(LEAST_NAMES, known.length)) {
    throw new Unreadable(`expected ARKit's names, such as jawOpen, and found ${columns.length} of them`);
  }
  const rows = table.rows.filter(({ time, values }) => Number.isFinite(time) && columns.every(([, i]) => Number.isFinite(values[i])));
  if (!rows.length) throw new Unreadable("expected rows of numbers, found none");
  return { ...even(rows, columns), known: columns.length };
}

// Pairs of our name and the column: upper and lower case, _L and _R do not matter.
function matched(names, known) {
  const own = new Map(known.map((name) => [name.toLowerCase(), name]));
  const columns = new Map();
  names.forEach((name, index) => {
    const plain = String(name).trim().toLowerCase().replace(/_l$/, "left").replace(/_r$/, "right").replace(/_/g, "");
    if (own.has(plain) && !columns.has(own.get(plain))) columns.set(own.get(plain), index);
  });
  return [...columns];
}

function jsonTable(text) {
  let data;
  try {
    data = JSON.parse(text);
  } catch {
    throw new Unreadable("it is no valid JSON");
  }
  const names = data?.names ?? data?.metadata?.blendshape_names;
  const frames = data?.frames;
  if (!Array.isArray(names) || !Array.isArray(frames) || !frames.length || frames.length > MOST_ROWS) {
    throw new Unreadable("expected lists of names and frames");
  }
  const fps = Number(data.metadata?.fps) || USUAL_RATE;
  const timed = frames.some((frame) => Number.isFinite(frame?.time));
  const rows = frames.map((frame, index) => ({
    time: timed ? frame?.time : index / fps,
    values: Array.isArray(frame?.weights) && frame.weights.length === names.length ? frame.weights : [],
  }));
  return { names, rows };
}

function csvTable(text) {
  const lines = text.replace(/^\uFEFF/, "").split(/\r?\n/).filter((line) => line.trim());
  if (lines.length < 2 || lines.length > MOST_ROWS) throw new Unreadable("expected a line of names and lines of scores");
  const [names, ...body] = lines.map((line) => line.split(",").map((cell) => cell.trim().replace(/^"(.*)"$/, "$1")));
  const code = names.findIndex((name) => name.toLowerCase() === "timecode");
  const times = code < 0 ? body.map((_, index) => index / USUAL_RATE) : timesOf(body.map((cells) => cells[code] ?? ""));
  const rows = body.map((cells, index) => ({ time: times[index], values: cells.map((cell) => (cell === "" ? NaN : Number(cell))) }));
  return { names, rows };
}

// Seconds of HH:MM:SS:FF.fff; FF counts frames of a rate that the largest FF shows.
function timesOf(codes) {
  const parts = codes.map((code) => (code.match(TIME_CODE) || []).slice(1).map(Number));
  const largest = parts.reduce((most, part) => Math.max(most, part[3] ?? 0), 0);
  const rate = largest >= 30 ? 60 : 30;
  return parts.map(([h, m, s, f]) => h * 3600 + m * 60 + s + f / rate);
}

// The rows at an even rate, each between its neighbors in time; rows that are not later than the one before are dropped.
function even(rows, columns) {
  const kept = [];
  for (const row of rows) if (!kept.length || row.time > kept[kept.length - 1].time) kept.push(row);
  const first = kept[0].time;
  const length = kept[kept.length - 1].time - first;
  const fps = length > 0 ? Math.min(60, Math.max(5, Math.round((kept.length - 1) / length))) : USUAL_RATE;
  const count = Math.min(Math.floor(length * fps + 1e-6) + 1, MOST_ROWS);
  const frames = [];
  for (let index = 0, before = 0; index < count; index++) {
    const time = first + index / fps;
    while (before + 1 < kept.length - 1 && kept[before + 1].time <= time) before++;
    frames.push(between(kept[before], kept[Math.min(before + 1, kept.length - 1)], time, columns));
  }
  return { fps, frames };
}

function between(a, b, time, columns) {
  const share = b.time > a.time ? Math.min(1, (time - a.time) / (b.time - a.time)) : 0;
  return Object.fromEntries(columns.map(([name, i]) => [name, a.values[i] + share * (b.values[i] - a.values[i])]));
}
