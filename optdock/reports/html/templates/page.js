"use strict";
(() => {
  const palette = JSON.parse(document.getElementById("report-data").textContent).palette;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const drawn = new Map(); // document of BokehJS for each place of a figure
  let queue = Promise.resolve();
  Bokeh.set_log_level("warn");

  const coloured = (text) =>
    dark.matches ? text.replace(/"(#[0-9A-F]{6})"/g, (all, light) => (light in palette ? `"${palette[light]}"` : all)) : text;

  async function draw(source) {
    const place = document.getElementById(source.dataset.for);
    const chapter = place.closest("details");
    if (chapter && !chapter.open) return;
    if (drawn.has(place.id)) return;
    drawn.set(place.id, null);
    await Bokeh.embed.embed_item(JSON.parse(coloured(source.textContent)), place.id);
    drawn.set(place.id, Bokeh.documents[Bokeh.documents.length - 1]);
    maps.get(place.id)?.show();
    if (chapter) players.get(chapter)?.show();
    await new Promise((resume) => setTimeout(resume, 0));
  }

  function drawAll(within) {
    for (const source of within.querySelectorAll("script.figure")) {
      queue = queue.then(() => draw(source)).catch((error) => console.error(error));
    }
    return queue;
  }

  function redraw() {
    queue = queue.then(() => {
      for (const [place, document_] of drawn) {
        document_?.clear();
        document.getElementById(place).replaceChildren();
      }
      Bokeh.documents.length = 0;
      drawn.clear();
    });
    drawAll(document);
  }

  const moved = (pose, points) => {
    const [x, y, yaw] = pose, c = Math.cos(yaw), s = Math.sin(yaw);
    return { x: points.map((p) => x + c * p[0] - s * p[1]), y: points.map((p) => y + s * p[0] + c * p[1]) };
  };

  function player(chapter) {
    const box = chapter.querySelector(".player");
    const motion = JSON.parse(box.querySelector(".motion").textContent);
    const slider = box.querySelector("input"), button = box.querySelector("button");
    const speed = box.querySelector("select"), output = box.querySelector("output");
    const nose = [[0, 0], [Math.max(0, ...motion.outline.map((p) => p[0])), 0]];
    let begun = null; // [time stamp, value of the clock] when the playing began

    function show() {
      const i = slider.valueAsNumber, at = motion.at[i];
      for (const place of chapter.querySelectorAll(".plot, .scene")) {
        const figure = drawn.get(place.id);
        const cursor = figure?.get_model_by_name("cursor"), robot = figure?.get_model_by_name("robot");
        if (cursor) cursor.location = at;
        if (robot) {
          robot.data_source.data = moved(motion.poses[i], motion.outline);
          figure.get_model_by_name("robot-nose").data_source.data = moved(motion.poses[i], nose);
        }
      }
      const [x, y, yaw] = motion.poses[i];
      const values = [[motion.clock, motion.unit, at], ["x", "m", x], ["y", "m", y], ["yaw", "rad", yaw],
        ...motion.readouts.map((one) => [one.label, one.unit, one.values[i]])];
      output.replaceChildren(...values.flatMap(([label, unit, value]) => {
        const entry = document.createElement("span"), number = document.createElement("b");
        number.textContent = value === null ? "–" : typeof value === "string" ? value : `${value.toFixed(3)} ${unit}`;
        entry.append(`${label} `, number);
        return [entry, " "];
      }));
      slider.setAttribute("aria-valuetext", `${at.toFixed(2)} ${motion.unit}`);
    }

    function stop() {
      begun = null;
      button.textContent = "Play";
      button.setAttribute("aria-pressed", "false");
    }

    function advance(now) {
      if (begun === null) return;
      const wanted = begun[1] + (speed.value * (now - begun[0])) / 1000;
      const next = motion.at.findIndex((value) => value >= wanted);
      slider.value = next < 0 ? motion.at.length - 1 : next;
      show();
      if (next < 0) stop(); else requestAnimationFrame(advance);
    }

    button.addEventListener("click", () => {
      if (begun !== null) return stop();
      if (slider.valueAsNumber === motion.at.length - 1) slider.value = 0;
      begun = [performance.now(), motion.at[slider.valueAsNumber]];
      button.textContent = "Pause";
      button.setAttribute("aria-pressed", "true");
      requestAnimationFrame(advance);
    });
    slider.addEventListener("input", () => { stop(); show(); });
    speed.addEventListener("change", () => { if (begun !== null) begun = [performance.now(), motion.at[slider.valueAsNumber]]; });
    show();
    return { show };
  }

  function layers(box) {
    const names = JSON.parse(box.querySelector("script").textContent);
    const slider = box.querySelector("input"), output = box.querySelector("output");
    const show = () => {
      const figure = drawn.get(box.dataset.for);
      names.forEach((name, i) => {
        const layer = figure?.get_model_by_name(`layer-${i}`);
        if (layer) layer.visible = i === slider.valueAsNumber;
      });
      output.textContent = names[slider.valueAsNumber];
      slider.setAttribute("aria-valuetext", output.textContent);
    };
    slider.addEventListener("input", show);
    return { show };
  }

  const maps = new Map();
  for (const box of document.querySelectorAll(".layers")) maps.set(box.dataset.for, layers(box));
  const players = new Map();
  for (const chapter of document.querySelectorAll("details.chapter")) {
    if (chapter.querySelector(".player")) players.set(chapter, player(chapter));
    chapter.addEventListener("toggle", () => { if (chapter.open) drawAll(chapter); });
  }
  const opened = () => {
    const chapter = document.getElementById(location.hash.slice(1));
    if (!chapter?.matches("details.chapter")) return;
    chapter.open = true;
    chapter.scrollIntoView();
  };
  window.addEventListener("hashchange", opened);
  opened();
  dark.addEventListener("change", redraw);
  drawAll(document).then(() => { document.documentElement.dataset.drawn = "yes"; });
})();
