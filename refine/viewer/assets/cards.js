// What stands below the stage: the loop's pictures, speeds of parts, loss terms, numbers. Text is set as text only.

const SVG = "http://www.w3.org/2000/svg";
const LINES = ["var(--line-1)", "var(--line-2)", "var(--line-3)", "var(--line-4)", "var(--line-5)", "var(--line-6)"];

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  return dressed(made, attributes, children);
}

function drawn(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  return dressed(made, attributes, children);
}

function dressed(made, attributes, children) {
  for (const [key, value] of Object.entries(attributes))
    if (value !== undefined && value !== false) made.setAttribute(key, value === true ? "" : value);
  made.append(...children);
  return made;
}

const spoken = (name) => name.replaceAll("_", " ");
const figures = (value) =>
  value === 0 ? "0" : Math.abs(value) < 0.01 ? value.toExponential(1).replace("e-", "e−") : value.toPrecision(3);

// A choice of one among several, as radio buttons in a row.
function choice(legend, names, chosen, changed) {
  const group = element("fieldset", { class: "choice" }, element("legend", { class: "unseen" }, legend));
  const name = `choice-${legend.replace(/\W/g, "-")}`;
  names.forEach((text, index) => {
    const input = element("input", { type: "radio", name, value: index, checked: index === chosen });
    input.addEventListener("change", () => changed(index));
    group.append(element("label", {}, input, element("span", {}, text)));
  });
  return group;
}

class LoopCard {
  constructor(card, looking, clips, go) {
    Object.assign(this, { card, looking, clips, made: looking.made.length - 1, view: 0, moment: -1 });
    const choices = element("div", { class: "choices" });
    const again = () => {
      this.moment = -1;
      go();
    };
    if (looking.made.length > 1)
      choices.append(
        choice(
          "Composition",
          looking.made.map((made) => made.name),
          this.made,
          (k) => {
            this.made = k;
            again();
          },
        ),
      );
    if (looking.made[0].views > 1) {
      const names = Array.from({ length: looking.made[0].views }, (_, k) => `view ${k + 1}`);
      choices.append(
        choice("View", names, 0, (k) => {
          this.view = k;
          again();
        }),
      );
    }
    card.querySelector("header").append(choices);
    this.rows = [0, 1].map((side) => this.row(side));
    card.querySelector(".rows").append(...this.rows.map((row) => row.figure));
  }

  row(side) {
    const cells = this.looking.stages.map((stage) => {
      const picture = element("div", { class: "cell", role: "img" });
      return { stage, picture, figure: element("figure", {}, picture, element("figcaption", {}, stage)) };
    });
    const title = element("p", { class: "row-title" });
    return {
      side,
      cells,
      title,
      figure: element(
        "div",
        { class: "row" },
        title,
        element("div", { class: "cells" }, ...cells.map((cell) => cell.figure)),
      ),
    };
  }

  get current() {
    return this.looking.made[this.made];
  }

  nearest(frame) {
    let best = 0;
    this.looking.moments.forEach((at, k) => {
      if (Math.abs(at - frame) < Math.abs(this.looking.moments[best] - frame)) best = k;
    });
    return best;
  }

  update(frame) {
    const moment = this.nearest(frame);
    if (moment === this.moment) return;
    this.moment = moment;
    const { moments, stages } = this.looking;
    const { sheets, loss, answers } = this.current;
    const last = (count) => Math.max(1, count - 1);
    for (const { side, cells, title } of this.rows) {
      const label = this.clips[side].name;
      const value = figures(loss[side][moments[moment]]);
      title.replaceChildren(
        element("strong", {}, label),
        ` ${answers[side]}${answers[side] ? " · " : ""}loss ${value}`,
      );
      cells.forEach(({ stage, picture }, row) => {
        picture.style.backgroundImage = `url("${sheets[side][this.view]}")`;
        picture.style.backgroundSize = `${100 * moments.length}% ${100 * stages.length}%`;
        picture.style.backgroundPosition = `${(100 * moment) / last(moments.length)}% ${(100 * row) / last(stages.length)}%`;
        picture.setAttribute("aria-label", `${stage} of ${label}, frame ${moments[moment] + 1}`);
      });
    }
    this.card.querySelector(".at").textContent = `frame ${moments[moment] + 1}`;
  }
}

class SpeedsCard {
  constructor(card, clips, parts) {
    this.clips = clips;
    this.greatest = Math.max(0.05, ...clips.map((clip) => greatestOf(clip.speeds)));
    const head = element("tr", {}, element("td"), ...clips.map((clip) => element("th", { scope: "col" }, clip.name)));
    this.cells = parts.map((part, row) =>
      clips.map((clip) => {
        const bar = element("span", { class: `bar ${part}` });
        const mean = element("span", { class: "mean" });
        mean.style.left = `${(100 * clip.speed[row]) / this.greatest}%`;
        const number = element("span", { class: "number" });
        return { bar, number, cell: element("td", {}, element("span", { class: "track" }, bar, mean), number) };
      }),
    );
    const rows = parts.map((part, row) =>
      element("tr", {}, element("th", { scope: "row" }, spoken(part)), ...this.cells[row].map((made) => made.cell)),
    );
    card.querySelector("table").append(element("thead", {}, head), element("tbody", {}, ...rows));
    card.querySelector("table").style.setProperty("--columns", clips.length);
    this.told = -Infinity;
  }

  update(seconds, now) {
    const tell = now - this.told > 120;
    if (tell) this.told = now;
    this.clips.forEach((clip, column) =>
      clip.speedsAt(seconds).forEach((speed, row) => {
        const { bar, number } = this.cells[row][column];
        bar.style.transform = `scaleX(${speed / this.greatest})`;
        if (tell) number.textContent = speed.toFixed(2);
      }),
    );
    return !tell;
  }
}

// Loss terms over the steps of a refinement, on a logarithmic axis.
class LossCard {
  constructor(card, terms) {
    const names = Object.keys(terms).filter((name) => terms[name].some((value) => value > 0));
    const steps = Math.max(...names.map((name) => terms[name].length));
    const greatest = Math.max(...names.flatMap((name) => terms[name]).filter((value) => value > 0));
    const shown = (value) => value > greatest * 1e-8;
    const all = names.flatMap((name) => terms[name]).filter(shown);
    const low = Math.floor(Math.log10(Math.min(...all)));
    const high = Math.max(low + 1, Math.ceil(Math.log10(greatest)));
    const [width, height, left, right, top, bottom] = [640, 300, 54, 8, 12, 28];
    const x = (step) => left + ((width - left - right) * step) / Math.max(1, steps - 1);
    const y = (value) => top + ((height - top - bottom) * (high - Math.log10(value))) / (high - low);
    const svg = drawn("svg", {
      viewBox: `0 0 ${width} ${height}`,
      role: "img",
      "aria-label": `Loss terms over ${steps} steps`,
    });
    const every = Math.ceil((high - low) / 5);
    for (let power = low; power <= high; power += every) {
      svg.append(drawn("line", { class: "rule", x1: left, x2: width - right, y1: y(10 ** power), y2: y(10 ** power) }));
      svg.append(
        drawn("text", { x: left - 8, y: y(10 ** power) + 4, "text-anchor": "end" }, `10${superscript(power)}`),
      );
    }
    for (const step of new Set([0, 1, 2, 3, 4].map((k) => Math.round(((steps - 1) * k) / 4)))) {
      const anchor = step === steps - 1 ? "end" : step ? "middle" : "start";
      svg.append(drawn("text", { x: x(step), y: height - 8, "text-anchor": anchor }, step + 1));
    }
    names.forEach((name, k) => {
      let pen = "M";
      const path = terms[name].map((value, step) => {
        if (!shown(value)) {
          pen = "M";
          return "";
        }
        const point = `${pen}${x(step).toFixed(1)} ${y(value).toFixed(1)}`;
        pen = "L";
        return point;
      });
      const line = drawn("path", { d: path.join(""), class: name === "total" ? "curve main" : "curve" });
      line.style.stroke = LINES[k % LINES.length];
      svg.append(line);
    });
    const cursor = drawn("line", { class: "cursor", y1: top, y2: height - bottom, opacity: 0 });
    svg.append(cursor);
    const values = names.map(() => element("b"));
    const legend = element(
      "ul",
      { class: "legend" },
      ...names.map((name, k) => {
        const swatch = element("i");
        swatch.style.background = LINES[k % LINES.length];
        return element("li", {}, swatch, name, " ", values[k]);
      }),
    );
    const step = element("span", { class: "at" });
    card.querySelector("header").append(step);
    const tell = (at) => {
      step.textContent = `step ${at + 1} of ${steps}`;
      names.forEach((name, k) => {
        values[k].textContent = terms[name][at] == null ? "–" : figures(terms[name][at]);
      });
    };
    tell(steps - 1);
    svg.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect();
      const at = ((event.clientX - box.left) / box.width) * width;
      const nearest = clamp(Math.round(((at - left) / (width - left - right)) * (steps - 1)), 0, steps - 1);
      for (const key of ["x1", "x2"]) cursor.setAttribute(key, x(nearest));
      cursor.setAttribute("opacity", 1);
      tell(nearest);
    });
    svg.addEventListener("pointerleave", () => {
      cursor.setAttribute("opacity", 0);
      tell(steps - 1);
    });
    card.append(svg, legend);
  }
}

const superscript = (number) => [...String(number)].map((sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)]).join("");

// As many decimals as make three figures, and no more than three.
const plainly = (value) => value.toFixed(clamp(2 - Math.floor(Math.log10(Math.abs(value) || 1)), 0, 3));

function numbersTable(table, clips) {
  const units = [...new Set(clips.flatMap((clip) => Object.keys(clip.numbers)))];
  const names = [["frames"], ["fps"], ["seconds"], ...units.map((name) => name.split(", "))];
  const heads = names.map(([name, unit]) =>
    element("th", { scope: "col" }, name, ...(unit ? [" ", element("small", {}, unit)] : [])),
  );
  const rows = clips.map((clip) => {
    const further = units.map((name) => (name in clip.numbers ? plainly(clip.numbers[name]) : ""));
    const name = element("th", { scope: "row" }, clip.name);
    if (clip.role && clip.label) name.append(" ", element("small", {}, clip.role));
    const values = [clip.frames, +clip.fps.toFixed(3), (clip.frames / clip.fps).toFixed(2), ...further];
    return element("tr", {}, name, ...values.map((value) => element("td", {}, String(value))));
  });
  table.append(element("thead", {}, element("tr", {}, element("td"), ...heads)), element("tbody", {}, ...rows));
}
