"use strict";
// Draws truth, ours and their signed relative error from the light itself, so that exposure and view can be chosen here.
// The layout of the data is described in embed.py: change both together. Without this script the page shows its PNGs.
(() => {
  const LUMA = [0.2126, 0.7152, 0.0722];

  const HALF = new Float32Array(65536);
  for (let i = 0; i < 65536; i++) {
    const exponent = (i >> 10) & 31, fraction = i & 1023, sign = i & 32768 ? -1 : 1;
    if (exponent === 31) HALF[i] = fraction ? NaN : sign * Infinity;
    else HALF[i] = sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
  }

  const toSrgb = (x) => 255 * (x <= 0.0031308 ? 12.92 * Math.max(x, 0) : 1.055 * Math.min(x, 1) ** (1 / 2.4) - 0.055);
  const toLinear = (byte) => (byte / 255 <= 0.04045 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4);

  async function unpack(info) {
    const raw = Uint8Array.from(atob(info.data), (c) => c.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = info.width * info.height;
    const halves = (at) => Float32Array.from({ length: 3 * n }, (_, i) => HALF[(bytes[at + i] << 8) | bytes[at + 3 * n + i]]);
    const albedo = Float32Array.from(bytes.subarray(12 * n, 15 * n), toLinear);
    return { truth: halves(0), ours: halves(6 * n), albedo, hit: bytes.subarray(15 * n, 16 * n) };
  }

  const luma = (a, i) => LUMA[0] * a[3 * i] + LUMA[1] * a[3 * i + 1] + LUMA[2] * a[3 * i + 2];

  // Sums over windows of (2r + 1)² pixels, by a summed-area table.
  function windowSums(values, width, height, r) {
    const table = new Float64Array((width + 1) * (height + 1));
    for (let y = 0; y < height; y++)
      for (let x = 0, row = 0; x < width; x++) {
        row += values[y * width + x];
        table[(y + 1) * (width + 1) + x + 1] = table[y * (width + 1) + x + 1] + row;
      }
    return values.map((_, i) => {
      const x = i % width, y = (i - x) / width;
      const x0 = Math.max(x - r, 0), x1 = Math.min(x + r + 1, width), y0 = Math.max(y - r, 0), y1 = Math.min(y + r + 1, height);
      const at = (yy, xx) => table[yy * (width + 1) + xx];
      return at(y1, x1) - at(y0, x1) - at(y1, x0) + at(y0, x0);
    });
  }

  function relativeErrors(light, info, radius) {
    const n = info.width * info.height, difference = new Float64Array(n), below = new Float64Array(n);
    for (let i = 0; i < n; i++) {
      const truth = luma(light.truth, i), gap = luma(light.ours, i) - truth;
      if (!light.hit[i] || (radius && !Number.isFinite(gap))) continue;
      difference[i] = gap;
      below[i] = Math.abs(truth) + info.floor;
    }
    const top = radius ? windowSums(difference, info.width, info.height, radius) : difference;
    const bottom = radius ? windowSums(below, info.width, info.height, radius) : below;
    return top.map((d, i) => (bottom[i] > 0 ? d / bottom[i] : Math.sign(d)));
  }

  function errorColour(value, info) {
    if (!Number.isFinite(value)) return [255, 0, 255];
    const place = Math.min(Math.max(value / info.clip, -1), 1) / 2 + 0.5;
    let k = 1;
    while (k < info.stops.length - 1 && info.stops[k][0] < place) k++;
    const a = info.stops[k - 1], b = info.stops[k], t = (place - a[0]) / (b[0] - a[0]);
    return [1, 2, 3].map((c) => a[c] + t * (b[c] - a[c]));
  }

  function lightColour(source, light, info, i, gain, reflected) {
    const rgb = [0, 1, 2].map((c) => source[3 * i + c] * (reflected ? light.albedo[3 * i + c] : 1) * gain);
    return rgb.every(Number.isFinite) ? rgb.map(toSrgb) : [255, 0, 255];
  }

  const figures = (v) => (v === 0 ? "0" : Math.abs(v) >= 1e-3 && Math.abs(v) < 1e5 ? v.toPrecision(3) : v.toExponential(2));

  async function activate(view) {
    const info = JSON.parse(view.querySelector(".pixels").textContent);
    const light = await unpack(info), n = info.width * info.height;
    const find = (role) => view.querySelector(`[data-role="${role}"]`);
    const canvases = {};
    for (const frame of view.querySelectorAll(".frame[data-picture]")) {
      const canvas = document.createElement("canvas"), image = frame.querySelector("img");
      canvas.width = info.width;
      canvas.height = info.height;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", image.alt);
      image.replaceWith(canvas);
      canvases[frame.dataset.picture] = { canvas, image: new ImageData(info.width, info.height) };
    }
    let errors = relativeErrors(light, info, 0), swapped = false, pointed = -1;

    const fill = (name, colour) => {
      const data = canvases[name].image.data;
      for (let i = 0; i < n; i++) {
        const rgb = light.hit[i] ? colour(i) : info.gray;
        data.set([Math.round(rgb[0]), Math.round(rgb[1]), Math.round(rgb[2]), 255], 4 * i);
      }
    };
    const show = () => {
      for (const { canvas, image } of Object.values(canvases)) {
        const pen = canvas.getContext("2d");
        pen.putImageData(image, 0, 0);
        if (pointed < 0) continue;
        const x = pointed % info.width, y = (pointed - x) / info.width;
        pen.strokeStyle = "#000";
        pen.strokeRect(x - 2.5, y - 2.5, 6, 6);
        pen.strokeStyle = "#fff";
        pen.strokeRect(x - 3.5, y - 3.5, 8, 8);
      }
    };
    const drawLight = () => {
      const mode = find("mode").value, gain = info.white[mode] * 2 ** Number(find("exposure").value);
      fill("truth", (i) => lightColour(swapped ? light.ours : light.truth, light, info, i, gain, mode === "reflected"));
      fill("ours", (i) => lightColour(swapped ? light.truth : light.ours, light, info, i, gain, mode === "reflected"));
      const stops = Number(find("exposure").value);
      find("stops").value = `${stops > 0 ? "+" : ""}${stops.toFixed(1)} stops`;
      show();
    };
    const drawError = () => {
      errors = relativeErrors(light, info, Number(find("average").value));
      fill("error", (i) => errorColour(errors[i], info));
      show();
    };
    const rgbText = (source, i) => [0, 1, 2].map((c) => figures(source[3 * i + c] * info.unit).padStart(8)).join(" ");
    const point = (event) => {
      const box = event.currentTarget.getBoundingClientRect();
      pick(Math.floor(((event.clientX - box.left) / box.width) * info.width),
        Math.floor(((event.clientY - box.top) / box.height) * info.height));
    };
    const step = (event) => {
      const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (!move) return;
      event.preventDefault();
      const from = pointed < 0 ? Math.floor(info.height / 2) * info.width + Math.floor(info.width / 2) : pointed;
      const far = event.shiftKey ? 10 : 1, x = from % info.width, y = (from - x) / info.width;
      pick(x + far * move[0], y + far * move[1]);
    };
    const said = (x, y) => {
      const where = `pixel ${x}, ${y}`, i = y * info.width + x;
      return light.hit[i]
        ? `${where}   truth ${rgbText(light.truth, i)}   ours ${rgbText(light.ours, i)} W/m²   error ` +
          `${errors[i] > 0 ? "+" : ""}${(100 * errors[i]).toFixed(1)} %`
        : `${where}   no surface`;
    };
    const pick = (x, y) => {
      if (x < 0 || y < 0 || x >= info.width || y >= info.height) return;
      pointed = y * info.width + x;
      find("readout").textContent = said(x, y);
      show();
    };
    // What was clicked stays, with the command that says which probes light it.
    const keep = () => {
      if (pointed < 0) return;
      const x = pointed % info.width, y = (pointed - x) / info.width, place = find("clicked");
      const command = place.dataset.explain.replace("{pixel}", `${x},${y}`);
      place.textContent = light.hit[pointed] ? `clicked: ${said(x, y)}\n${command}` : `clicked: ${said(x, y)}`;
    };
    const swap = (on) => () => {
      if (swapped === on) return;
      swapped = on;
      view.classList.toggle("swapped", on);
      find("swap").setAttribute("aria-pressed", String(on));
      const [truth, ours] = ["truth", "ours"].map((name) => canvases[name].canvas.closest("figure"));
      const captions = [truth, ours].map((figure) => figure.querySelector("figcaption"));
      truth.append(captions[1]);
      ours.append(captions[0]);
      drawLight();
    };
    for (const { canvas } of Object.values(canvases)) {
      canvas.tabIndex = 0;
      canvas.addEventListener("keydown", step);
      canvas.addEventListener("pointermove", point);
      canvas.addEventListener("click", (event) => { point(event); keep(); });
      canvas.addEventListener("keydown", (event) => { if (event.key === "Enter") keep(); });
      canvas.addEventListener("pointerleave", () => { pointed = -1; show(); });
    }
    for (const name of ["truth", "ours"]) {
      canvases[name].canvas.addEventListener("pointerdown", swap(true));
      for (const end of ["pointerup", "pointerleave", "pointercancel"]) canvases[name].canvas.addEventListener(end, swap(false));
    }
    find("swap").addEventListener("click", () => swap(!swapped)());
    find("exposure").addEventListener("input", drawLight);
    find("mode").addEventListener("input", drawLight);
    find("average").addEventListener("input", drawError);
    find("reset").addEventListener("click", () => { find("exposure").value = 0; drawLight(); });
    drawLight();
    drawError();
    view.querySelector(".tools").hidden = false;
    find("readout").textContent = "Point at a picture, or focus it and use the arrow keys, to read its values; click (or Enter) to keep them with the command that explains the pixel; press and hold truth or ours to swap the two.";
    view.dataset.drawn = "yes";
  }

  (async () => {
    for (const view of document.querySelectorAll(".view")) {
      try {
        await activate(view);
      } catch (problem) {
        view.dataset.drawn = "no";
        console.error(problem);
      }
    }
  })();
})();
