// The sliders: what they are called and move comes from the file, so texts are set as text and never as markup.

const DEGREES = 180 / Math.PI;
const STEPS = 200;
const MANY = 12; // sliders from which a group has a field to search it
const TURNS = [["turn", "yaw"], ["nod", "pitch"], ["tilt", "roll"]];
const LARGEST_TILT = 0.35; // rad

export class Panel {
  // `change(apply)`: called when a slider moves, with a function that changes a drive; `turn` likewise for the head's pose.
  constructor(root, description, { change, turn }) {
    this.sliders = [];
    const groups = new Map();
    for (const slider of description.controls.sliders) {
      if (!groups.has(slider.group)) groups.set(slider.group, []);
      groups.get(slider.group).push(driveSlider(slider, change));
    }
    const face = groups.get("Face") || [];
    groups.delete("Face");
    if (face.length) this.addGroup(root, "Face", face, true);
    this.addGroup(root, "Head", turnSliders(description, turn), true);
    for (const [name, sliders] of groups) this.addGroup(root, name, sliders, false);
  }

  addGroup(root, name, sliders, open) {
    const group = element("details", { open });
    group.append(element("summary", { textContent: name }));
    const rows = sliders.map((slider) => this.addSlider(slider));
    if (rows.length >= MANY) group.append(searchField(name, rows));
    group.append(...rows);
    root.append(group);
  }

  addSlider({ label, unit, low, high, read, write }) {
    const row = element("label", { className: "row" });
    const input = element("input", { type: "range", min: low, max: high, step: (high - low) / STEPS, value: 0 });
    const output = element("output", {});
    input.setAttribute("aria-label", label); // else its value, which stands in the same label, would be part of its name
    const show = () => {
      const value = Number(input.value);
      output.textContent = unit === "rad" ? `${Math.round(value * DEGREES)}°` : value.toFixed(2);
      input.setAttribute("aria-valuetext", unit === "rad" ? `${Math.round(value * DEGREES)} degrees` : value.toFixed(2));
    };
    input.addEventListener("input", () => {
      show();
      write(Number(input.value));
    });
    row.append(element("span", { textContent: label }), input, output);
    this.sliders.push({ input, read, show });
    show();
    return row;
  }

  // Sets all sliders to a drive and a pose; the one that is being moved has its value already.
  show(drive, pose) {
    for (const { input, read, show } of this.sliders) {
      const value = read(drive, pose);
      if (Math.abs(Number(input.value) - value) < Number(input.step) / 2) continue;
      input.value = value;
      show();
    }
  }
}

function driveSlider({ label, unit, low, high, targets }, change) {
  const [[part, index, factor]] = targets;
  const write = (value) => change((drive) => {
    for (const [name, place, amount] of targets) {
      drive[name] = [...drive[name]];
      drive[name][place] = value * amount;
    }
  });
  return { label, unit, low, high, read: (drive) => drive[part][index] / factor, write };
}

// The head's own turn; its range is that of the views in training, seen from the head.
function turnSliders({ controls }, turn) {
  const ranges = { yaw: controls.view.yaw.map((value) => -value).reverse(), pitch: controls.view.pitch };
  ranges.roll = [-LARGEST_TILT, LARGEST_TILT];
  return TURNS.map(([label, name]) => ({
    label, unit: "rad", low: ranges[name][0], high: ranges[name][1], read: (_, pose) => pose[name], write: (value) => turn(name, value),
  }));
}

// Hides the rows whose name does not contain what is typed.
function searchField(name, rows) {
  const field = element("input", { type: "search", placeholder: "Search" });
  field.setAttribute("aria-label", `Search in ${name}`);
  field.addEventListener("input", () => {
    const wanted = field.value.trim().toLowerCase();
    for (const row of rows) row.hidden = !row.firstChild.textContent.toLowerCase().includes(wanted);
  });
  return field;
}

export function element(name, properties) {
  return Object.assign(document.createElement(name), properties);
}
