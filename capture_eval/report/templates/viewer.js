(function () {
  "use strict";
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const MISSING = 65535;

  function bytes(text) {
    const raw = atob(text);
    const out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }
  const u16 = (text) => new Uint16Array(bytes(text));
  const i32 = (text) => new Int32Array(bytes(text));

  // The viewer's axes, right-handed: x = the subject's right, y = the way the face looks, z = up.
  const up = data.up, front = data.front;
  const side = [front[1] * up[2] - front[2] * up[1], front[2] * up[0] - front[0] * up[2], front[0] * up[1] - front[1] * up[0]];
  function positions(steps, pose, count) {
    const out = [new Float32Array(count), new Float32Array(count), new Float32Array(count)];
    for (let k = 0, at = pose * count * 3; k < count; k++, at += 3) {
      if (steps[at] === MISSING) { out[0][k] = out[1][k] = out[2][k] = NaN; continue; }
      const p = [0, 1, 2].map((a) => data.low[a] + steps[at + a] * data.step);
      out[0][k] = side[0] * p[0] + side[1] * p[1] + side[2] * p[2];
      out[1][k] = front[0] * p[0] + front[1] * p[1] + front[2] * p[2];
      out[2][k] = up[0] * p[0] + up[1] * p[1] + up[2] * p[2];
    }
    return out;
  }

  const draw = i32(data.curves.draw), owner = u16(data.curves.owner), vertices = i32(data.curves.vertices);
  const points = vertices.length;
  const truth = u16(data.curves.truth);
  const methods = data.methods.map((m) => ({ label: m.label, positions: u16(m.positions), errors: u16(m.errors) }));
  const face = data.face && {
    count: data.face.count, positions: u16(data.face.positions), triangles: i32(data.face.triangles),
    confidence: data.face.confidence && new Uint8Array(bytes(data.face.confidence)),
  };

  function strokes(xyz) {
    const out = [[], [], []];
    for (let k = 0; k < draw.length; k++)
      for (let a = 0; a < 3; a++) out[a].push(draw[k] < 0 ? null : xyz[a][draw[k]]);
    return out;
  }
  function normals(xyz) {
    const n = [0, 1, 2].map(() => new Float32Array(face.count)), f = face.triangles;
    for (let k = 0; k < f.length; k += 3) {
      const e = [0, 1, 2].map((a) => xyz[a][f[k + 1]] - xyz[a][f[k]]), g = [0, 1, 2].map((a) => xyz[a][f[k + 2]] - xyz[a][f[k]]);
      const c = [e[1] * g[2] - e[2] * g[1], e[2] * g[0] - e[0] * g[2], e[0] * g[1] - e[1] * g[0]];
      for (let corner = 0; corner < 3; corner++) for (let a = 0; a < 3; a++) n[a][f[k + corner]] += c[a];
    }
    for (let k = 0; k < face.count; k++) {
      const length = Math.hypot(n[0][k], n[1][k], n[2][k]) || 1;
      for (let a = 0; a < 3; a++) n[a][k] /= length;
    }
    return n;
  }
  function moved(xyz, along, rows, amount) {
    // Curves lie in the skin: the skin is drawn a little deeper and the prediction a little higher, to be seen.
    if (!along) return xyz;
    for (let k = 0; k < xyz[0].length; k++) {
      const row = rows ? rows[k] : k;
      for (let a = 0; a < 3; a++) xyz[a][k] += amount * along[a][row];
    }
    return xyz;
  }

  const escaped = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const plot = document.getElementById("viewer-plot");
  const control = (name) => document.getElementById("viewer-" + name);
  const lift = 0.003 * data.diameter;
  const corners = face && [0, 1, 2].map((c) => { const out = new Int32Array(face.triangles.length / 3); for (let k = 0; k < out.length; k++) out[k] = face.triangles[3 * k + c]; return out; });

  // Light is put into the vertex colours: from the front, upper left, with a little from all sides.
  const lamps = [[0.45, 0.75, 0.5, 0.5], [-0.7, 0.5, 0.1, 0.2], [0, -1, 0.3, 0.12]].map((l) => { const n = Math.hypot(l[0], l[1], l[2]); return [l[0] / n, l[1] / n, l[2] / n, l[3]]; });
  const sure = [33, 102, 172], unsure = [179, 88, 6], middle = [232, 228, 220], clay = [216, 219, 224];
  const mix = (a, b, w) => [0, 1, 2].map((c) => a[c] + w * (b[c] - a[c]));
  function paint(pose, along, byConfidence) {
    const out = new Array(face.count);
    for (let k = 0; k < face.count; k++) {
      let light = 0.42;
      for (const l of lamps) light += l[3] * Math.max(0, l[0] * along[0][k] + l[1] * along[1][k] + l[2] * along[2][k]);
      const c = byConfidence ? face.confidence[pose * face.count + k] / 255 : 0;
      const base = !byConfidence ? clay : c < 0.5 ? mix(unsure, middle, 2 * c) : mix(middle, sure, 2 * c - 1);
      out[k] = "rgb(" + base.map((v) => Math.min(255, Math.round(v * light))).join(",") + ")";
    }
    return out;
  }
  function faceTrace(pose, along, depth) {
    const style = control("face").value;
    const base = { type: "mesh3d", hoverinfo: "skip", showscale: false, visible: style !== "none" && data.poses[pose].ok,
      lighting: { ambient: 1, diffuse: 0, specular: 0, fresnel: 0 } };
    if (!face) return Object.assign(base, { visible: false, x: [], y: [], z: [], i: [], j: [], k: [] });
    const xyz = moved(positions(face.positions, pose, face.count), along, null, -depth);
    return Object.assign(base, { x: xyz[0], y: xyz[1], z: xyz[2], i: corners[0], j: corners[1], k: corners[2],
      vertexcolor: paint(pose, along, style === "confidence" && face.confidence), opacity: style === "glass" ? 0.65 : 1 });
  }

  function traces() {
    const pose = +control("pose").value, which = +control("method").value, method = methods[which];
    const along = face ? normals(positions(face.positions, pose, face.count)) : null;
    const mine = face && face.whole ? along : null;
    const predicted = strokes(moved(positions(method.positions, pose, points), mine, vertices, lift));
    const real = strokes(positions(truth, pose, points));
    const colours = [], hover = [];
    let largest = 0;
    for (let k = 0; k < draw.length; k++) {
      const row = draw[k], step = row < 0 ? MISSING : method.errors[pose * points + row];
      const error = step === MISSING ? 0 : step * data.errorStep;
      largest = Math.max(largest, error);
      colours.push(step === MISSING ? -1 : Math.sqrt(error));
      hover.push(row < 0 ? "" : escaped(data.curves.names[owner[row]]) + ", vertex " + vertices[row] + "<br>" + (step === MISSING ? "does not count" : "error " + error.toFixed(3) + " % of D"));
    }
    const top = Math.sqrt(control("scale").checked ? Math.max(largest, 1e-9) : data.largestError);
    // Values under zero mark points that do not count; a hair of the scale below zero is grey.
    const stops = [[0, "#9AA0A8"], [0.0099, "#9AA0A8"]].concat(data.colours.map((stop) => [0.01 + 0.99 * stop[0], stop[1]]));
    const shown = colours.map((value) => value < 0 ? -0.0101 * top : value);
    const ticks = [0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].filter((v) => v === 0 || (Math.sqrt(v) <= top && Math.sqrt(v) > 0.15 * top));
    const wanted = control("curves").value;
    return { largest, list: [
      faceTrace(pose, along, 0.004 * data.diameter),
      { type: "scatter3d", mode: "lines", x: real[0], y: real[1], z: real[2], hoverinfo: "skip", visible: wanted !== "predicted",
        line: { color: "#111111", width: 1.5 }, showlegend: false },
      { type: "scatter3d", mode: "lines", x: predicted[0], y: predicted[1], z: predicted[2], text: hover, hoverinfo: "text", visible: wanted !== "truth",
        line: { color: shown, cmin: -0.0101 * top, cmax: top, colorscale: stops, width: 6, showscale: true,
          colorbar: { title: { text: "error (% of D)", side: "right" }, thickness: 12, len: 0.7, tickvals: ticks.map(Math.sqrt), ticktext: ticks.map(String) } }, showlegend: false },
    ] };
  }

  const views = { front: { x: 0.0, y: 1.62, z: 0.03 }, half: { x: -0.95, y: 1.3, z: 0.12 }, side: { x: -1.62, y: 0.08, z: 0.03 } };
  function camera(name) { return { eye: views[name], up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 }, projection: { type: "perspective" } }; }
  const hidden = { visible: false, showspikes: false };
  const layout = { margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "keep", showlegend: false, paper_bgcolor: "rgba(0,0,0,0)",
    font: { family: "system-ui, sans-serif", size: 12 },
    scene: { aspectmode: "data", xaxis: hidden, yaxis: hidden, zaxis: hidden, camera: camera("half"), uirevision: "keep" } };

  function update() {
    const pose = +control("pose").value, made = traces();
    Plotly.react(plot, made.list, layout, { responsive: true, displaylogo: false, displayModeBar: false });
    const row = data.poses[pose];
    control("state").textContent = row.ok
      ? "t = " + data.t[pose] + " · largest error of the curves " + made.largest.toFixed(3) + " % of D"
      : "t = " + data.t[pose] + " · this pose failed: " + row.reason;
    control("state").classList.toggle("failed", !row.ok);
  }
  for (const name of ["pose", "method", "face", "curves", "scale"]) control(name).addEventListener("input", update);
  for (const name of Object.keys(views))
    control("view-" + name).addEventListener("click", () => Plotly.relayout(plot, { "scene.camera": camera(name) }));
  let timer = null;
  control("play").addEventListener("click", () => {
    if (timer !== null) { clearInterval(timer); timer = null; control("play").textContent = "Play"; return; }
    control("play").textContent = "Stop";
    timer = setInterval(() => { control("pose").value = (+control("pose").value + 1) % data.t.length; update(); }, 450);
  });
  update();
})();
