// What rorg answers about an operation that is not carried out yet, in plain sentences.

const MOST = 12;

function list(names) {
  if (names.length > MOST) return `${names.slice(0, MOST).join(", ")} and ${names.length - MOST} more`;
  return names.length > 1 ? `${names.slice(0, -1).join(", ")} and ${names.at(-1)}` : names.join();
}

const verb = (names, one, several) => `${list(names)} ${names.length > 1 ? several : one}`;

/** The items by their key, in the order in which the keys first occur. */
function grouped(items, key) {
  const groups = new Map();
  for (const item of items) groups.set(key(item), [...(groups.get(key(item)) ?? []), item]);
  return [...groups.values()];
}

/** A service that gives way, or is kept out by a hold, pressure or the budget. */
function kept({ service, by, reason }, told) {
  const before = told.stops.includes(service) ? "Stops" : told.pauses.includes(service) ? "Pauses" : "";
  const why = by.length ? `gives way to ${list(by)} (${reason})` : `is kept out: ${reason}`;
  return before ? `${before} ${service}, which ${why}.` : `${service} ${why}.`;
}

function waits(names, reason, told) {
  if (names.every((name) => told.unwanted.includes(name))) return `${list(names)}: ${reason}.`;
  return reason.startsWith("waits ") ? `${list(names)} ${reason}.` : `${verb(names, "waits", "wait")}: ${reason}.`;
}

/** The sentences of an answer of /v1/preview. */
export function sentences(told) {
  const out = told.preempted.map((one) => one.service);
  const known = new Set([...told.starts, ...told.resumes, ...told.restarts, ...out, ...told.waits.map((one) => one.service)]);
  const stays = told.wanted.filter((name) => !known.has(name));
  const done = [["Restarts", told.restarts], ["Starts", told.starts], ["Resumes", told.resumes],
    ["Stops", told.stops.filter((name) => !out.includes(name))], ["Pauses", told.pauses.filter((name) => !out.includes(name))]];
  const lines = [
    ...done.filter(([, names]) => names.length).map(([word, names]) => `${word} ${list(names)}.`),
    ...told.preempted.map((one) => kept(one, told)),
    stays.length ? `${verb(stays, "is", "are")} wanted from now on, and ${stays.length > 1 ? "stay as they are" : "stays as it is"}.` : "",
    told.unwanted.length ? `No longer wanted: ${list(told.unwanted)}.` : "",
    ...grouped(told.waits, (one) => one.reason).map((same) => waits(same.map((one) => one.service), same[0].reason, told)),
    told.interlocked.length ? `Asks ${told.interlocked.length > 1 ? "the interlocks" : "the interlock"} of ${list(told.interlocked)} first.` : "",
  ].filter(Boolean);
  return lines.length ? lines : ["Nothing changes now."];
}
