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

  // The viewer's axes: x = to the right of the picture's subject, y = the way the face looks, z = up.
  const up = data.up, front = data.front;
  const side = [up[1] * front[2] - up[2] * front[1], up[2] * front[0] - up[0] * front[2], up[0] * front[1] - up[1] * front[0]];
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
  function outward(xyz, amount) {
    // Curves lie on the skin; lifting them a little keeps the skin from covering them.
    const count = xyz[0].length, centre = [0, 0, 0];
    for (let a = 0; a < 3; a++) { let sum = 0, n = 0; for (const v of xyz[a]) if (v === v) { sum += v; n++; } centre[a] = n ? sum / n : 0; }
    for (let k = 0; k < count; k++) {
      const d = [0, 1, 2].map((a) => xyz[a][k] - centre[a]);
      const length = Math.hypot(d[0], d[1], d[2]) || 1;
      for (let a = 0; a < 3; a++) xyz[a][k] += amount * d[a] / length;
    }
    return xyz;
  }

  const plot = document.getElementById("viewer-plot");
  const control = (name) => document.getElementById("viewer-" + name);
  const lift = 0.004 * data.step * 65534;
  const corners = face && [0, 1, 2].map((c) => { const out = new Int32Array(face.triangles.length / 3); for (let k = 0; k < out.length; k++) out[k] = face.triangles[3 * k + c]; return out; });

  function faceTrace(pose) {
    const style = control("face").value;
    const base = { type: "mesh3d", hoverinfo: "skip", flatshading: false, showscale: false, visible: style !== "none" && data.poses[pose].ok,
      lighting: { ambient: 0.55, diffuse: 0.6, specular: 0.08, roughness: 0.9, fresnel: 0.05 }, lightposition: { x: 2000, y: 4000, z: 3000 } };
    if (!face) return Object.assign(base, { visible: false, x: [], y: [], z: [], i: [], j: [], k: [] });
    const xyz = positions(face.positions, pose, face.count);
    Object.assign(base, { x: xyz[0], y: xyz[1], z: xyz[2], i: corners[0], j: corners[1], k: corners[2] });
    if (style === "confidence" && face.confidence) {
      base.intensity = Array.from(face.confidence.subarray(pose * face.count, (pose + 1) * face.count), (v) => v / 255);
      Object.assign(base, { cmin: 0, cmax: 1, colorscale: [[0, "#B35806"], [0.5, "#E8E4DC"], [1, "#2166AC"]] });
      Object.assign(base, { showscale: true, colorbar: { title: { text: "confidence" }, x: 0, xanchor: "left", thickness: 10, len: 0.5 } });
    } else { base.color = "#C9CDD3"; base.opacity = style === "glass" ? 0.3 : 1; }
    return base;
  }

  function traces() {
    const pose = +control("pose").value, which = +control("method").value, method = methods[which];
    const lifted = (steps) => strokes(outward(positions(steps, pose, points), lift));
    const predicted = lifted(method.positions), real = lifted(truth);
    const errors = [], hover = [];
    let largest = 0;
    for (let k = 0; k < draw.length; k++) {
      const row = draw[k], step = row < 0 ? MISSING : method.errors[pose * points + row];
      const error = step === MISSING ? 0 : step * data.errorStep;
      largest = Math.max(largest, error);
      errors.push(error);
      hover.push(row < 0 ? "" : data.curves.names[owner[row]] + ", vertex " + vertices[row] + "<br>error " + error.toFixed(3) + " % of D");
    }
    const top = control("scale").checked ? Math.max(largest, 1e-9) : data.largestError;
    const wanted = control("curves").value;
    return { largest, list: [
      faceTrace(pose),
      { type: "scatter3d", mode: "lines", x: real[0], y: real[1], z: real[2], hoverinfo: "skip", visible: wanted !== "predicted",
        line: { color: "#111111", width: 2 }, showlegend: false },
      { type: "scatter3d", mode: "lines", x: predicted[0], y: predicted[1], z: predicted[2], text: hover, hoverinfo: "text", visible: wanted !== "truth",
        line: { color: errors, cmin: 0, cmax: top, colorscale: data.colours, width: 6, showscale: true,
          colorbar: { title: { text: "error (% of D)", side: "right" }, thickness: 12, len: 0.7 } }, showlegend: false },
    ] };
  }

  const views = { front: { x: 0.0, y: 1.75, z: 0.05 }, half: { x: 1.15, y: 1.35, z: 0.15 }, side: { x: 1.75, y: 0.15, z: 0.05 } };
  function camera(name) { return { eye: views[name], up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 }, projection: { type: "orthographic" } }; }
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
