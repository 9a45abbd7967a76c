// Messages with a page that shows this one in a frame: only with the origin that the file names (docs/web-avatar.md).

const FROM_DISK = "null"; // the origin of pages that were opened from the disk, which no message can be addressed to

// `actions`: drive(scores, pose), rest(), play(name), pause(), view({yaw, pitch, distance}).
export function listenToEmbedder(origin, actions, facts) {
  if (!origin || window.parent === window) return;
  const tell = (message) => window.parent.postMessage(message, origin === FROM_DISK ? "*" : origin);
  window.addEventListener("message", (event) => {
    if (event.source !== window.parent || event.origin !== origin) return;
    const fault = obeyed(event.data, actions);
    if (fault) tell({ ggavatar: "error", message: fault });
  });
  tell({ ggavatar: "ready", ...facts });
}

// Does what a message says; a sentence where it is not one of ours.
export function obeyed(message, actions) {
  const { ggavatar: kind, arkit = {}, head = {}, ...rest } = Object(message);
  if (!kind) return null; // somebody else's
  if (kind === "drive") {
    if (!isNumbers(arkit) || !isNumbers(head)) return "drive: expected finite numbers in arkit and head";
    actions.drive(arkit, { yaw: head.yaw || 0, pitch: head.pitch || 0, roll: head.roll || 0 });
  } else if (kind === "rest") actions.rest();
  else if (kind === "play") return actions.play(rest.performance) ? null : "play: there is no such performance";
  else if (kind === "pause") actions.pause();
  else if (kind === "view") {
    if (!isNumbers(rest)) return "view: expected finite numbers yaw, pitch and distance";
    actions.view(rest);
  } else return `expected drive, rest, play, pause or view, found ${String(kind).slice(0, 40)}`;
  return null;
}

function isNumbers(value) {
  return Object(value) === value && Object.values(value).every((number) => Number.isFinite(number));
}
