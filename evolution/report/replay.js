// Draws a recorded robot in 3D on a 2D canvas, without libraries. The data come from replay.py.
// An ellipsoid with the half axes M is seen from far as the ellipse whose matrix is P M Mᵀ Pᵀ, where P
// projects onto the image. Parts are painted from back to front.
"use strict";
(() => {
  const find = (name) => document.getElementById(`replay-${name}`);
  const canvas = find("canvas"), play = find("play"), slider = find("time"), speed = find("speed");
  const pen = canvas.getContext("2d", { willReadFrequently: true }); // on the CPU: fast without a GPU too
  const data = JSON.parse(find("data").textContent);
  const unpack = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const bytes = (name) => unpack(data[name]);
  const poses = new Int16Array(bytes("poses").buffer), track = new Float32Array(bytes("track").buffer);
  const heat = bytes("heat"), touches = bytes("touches");
  const ground = data.ground && new Int32Array(unpack(data.ground.heights_um).buffer); // of uneven ground
  const frames = track.length / 3, last = frames - 1, long = data.length_m;
  const contact = "#ff8c0d", homeView = { turn: -0.5, tilt: 0.45, zoom: 1 };
  let view = { ...homeView }, frame = 0, playing = false, before = 0, queued = false, next = 0;
  let scale, centre, axes; // of the image: pixels per m, the point looked at, and directions

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const mix = (a, b, share) => a + (b - a) * share;
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  // Height of the ground, m.
  function elevation(x, y) {
    if (!ground) return 0;
    const { x_m, y_m, cell_m, columns } = data.ground, rows = ground.length / columns;
    const u = clamp((x - x_m) / cell_m, 0, columns - 1), v = clamp((y - y_m) / cell_m, 0, rows - 1);
    const i = Math.min(Math.floor(u), columns - 2), j = Math.min(Math.floor(v), rows - 2), k = j * columns + i;
    return 1e-6 * mix(mix(ground[k], ground[k + 1], u - i), mix(ground[k + columns], ground[k + columns + 1], u - i), v - j);
  }

  // Position and rotation matrix of each element, between two recorded frames.
  function locate() {
    const first = Math.min(Math.floor(frame), last), next = Math.min(first + 1, last);
    const share = frame - first, elements = [];
    for (let i = 0; i < data.elements; i++) {
      const a = poses.subarray(7 * (first * data.elements + i)), b = poses.subarray(7 * (next * data.elements + i));
      const at = [0, 1, 2].map((k) => data.scale_m * mix(a[k], b[k], share));
      let dots = 0;
      for (let k = 3; k < 7; k++) dots += a[k] * b[k];
      const q = [3, 4, 5, 6].map((k) => mix(a[k], dots < 0 ? -b[k] : b[k], share));
      const [w, x, y, z] = q.map((value) => value / Math.hypot(...q));
      elements.push({ at, turn: [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
      ] });
    }
    const at = [0, 1, 2].map((k) => mix(track[3 * first + k], track[3 * next + k], share));
    return { elements, x: at[0], y: at[1], energy: at[2], row: Math.round(frame) };
  }

  const place = ({ at, turn }, point) => turn.map((row, k) => at[k] + dot(row, point));

  function project(point) {
    const away = point.map((value, k) => value - centre[k]);
    const depth = dot(away, axes[2]), near = scale / (1 + depth / (5 * long)); // a weak perspective
    return { x: canvas.width / 2 + near * dot(away, axes[0]), y: canvas.height / 2 - near * dot(away, axes[1]), depth, near };
  }

  // Radii and direction of the ellipse with half axes that are the columns of two rows.
  function ellipse(a, b) {
    const xx = dot(a, a), yy = dot(b, b), xy = dot(a, b), half = Math.hypot((xx - yy) / 2, xy);
    return [Math.sqrt((xx + yy) / 2 + half), Math.sqrt(Math.max((xx + yy) / 2 - half, 0)), Math.atan2(2 * xy, xx - yy) / 2];
  }

  const onGround = (x, y) => [x, y, elevation(x, y)];

  function polygon(points) {
    pen.beginPath();
    for (const point of points) {
      const { x, y } = project(point);
      pen.lineTo(x, y);
    }
    pen.closePath();
  }

  // An ellipse on the ground.
  function spot(x, y, [long, short, angle]) {
    polygon(Array.from({ length: 24 }, (_, k) => {
      const c = long * Math.cos(k * Math.PI / 12), s = short * Math.sin(k * Math.PI / 12);
      return onGround(x + c * Math.cos(angle) - s * Math.sin(angle), y + c * Math.sin(angle) + s * Math.cos(angle));
    }));
    pen.fill();
  }

  function line(from, to, colour, width) {
    const a = project(from), b = project(to);
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    pen.moveTo(a.x, a.y);
    pen.lineTo(b.x, b.y);
    pen.stroke();
  }

  // A disc of ground with squares of 2 cm, and a ruler whose zero is the start.
  function drawGround(now, pixel, ink) {
    const radius = 1.3 * long, step = 0.02, side = now.y - 0.4 * long;
    pen.save();
    pen.fillStyle = "#8882";
    spot(now.x, now.y, [radius, radius, 0]);
    pen.clip();
    for (const [k, x] of [[0, now.x], [1, now.y]]) {
      for (let at = step * Math.ceil((x - radius) / step); at < x + radius; at += step) {
        const pieces = ground ? 40 : 1; // that follow the ground
        const points = Array.from({ length: pieces + 1 }, (_, n) => {
          const off = radius * (2 * n / pieces - 1);
          return k ? onGround(now.x + off, at) : onGround(at, now.y + off);
        });
        for (let n = 0; n < pieces; n++) line(points[n], points[n + 1], ground ? "#8886" : "#8883", pixel);
      }
    }
    pen.restore();
    const reach = Math.sqrt(radius ** 2 - (0.4 * long) ** 2), offset = now.x - data.start_m;
    const every = scale * 0.05 > 45 * pixel ? 5 : 10; // cm between two labels
    if (!ground) line([now.x - reach, side, 0], [now.x + reach, side, 0], ink, 1.5 * pixel);
    pen.fillStyle = ink;
    pen.font = `${12 * pixel}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    for (let cm = Math.ceil(100 * (offset - reach)); cm <= 100 * (offset + reach); cm++) {
      const x = data.start_m + cm / 100, labelled = cm % every === 0;
      line(onGround(x, side), onGround(x, side - (labelled ? 0.05 : 0.025) * long), ink, pixel);
      const text = project(onGround(x, side - 0.1 * long));
      if (labelled && Math.abs(cm / 100 - offset) < 0.95 * reach) pen.fillText(cm === 0 ? "0 cm" : cm, text.x, text.y);
    }
  }

  function drawEllipsoid(shape, { at, turn }, touching, ink) {
    const { x, y, near } = project(place({ at, turn }, shape.centre));
    const columns = [0, 1, 2].map((j) => [0, 1, 2].map((i) => turn[i][0] * shape.axes[0][j] + turn[i][1] * shape.axes[1][j] + turn[i][2] * shape.axes[2][j]));
    const [across, up] = axes.map((axis) => columns.map((column) => dot(axis, column)));
    const [long, short, angle] = ellipse(across, up);
    pen.beginPath();
    pen.ellipse(x, y, near * long, near * short, -angle, 0, 2 * Math.PI);
    if (shape.opacity === 1) { // a foot
      pen.fillStyle = touching ? contact : ink;
    } else {
      const colour = (lighter, opacity) => `rgb(${shape.colour.map((c) => clamp(c + lighter, 0, 255)).join(" ")} / ${opacity})`;
      const shine = pen.createRadialGradient(x - 0.3 * near * short, y - 0.5 * near * short, 0, x, y, near * long);
      shine.addColorStop(0, colour(90, 0.35));
      shine.addColorStop(0.6, colour(0, 0.4));
      shine.addColorStop(1, colour(-60, 0.6));
      pen.fillStyle = shine;
    }
    pen.fill();
  }

  function draw() {
    queued = false;
    const box = canvas.getBoundingClientRect(), pixel = Math.min(window.devicePixelRatio, 2);
    const ink = getComputedStyle(canvas).color, now = locate();
    const width = Math.round(box.width * pixel), height = Math.round(box.height * pixel);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    pen.clearRect(0, 0, width, height);
    const c = Math.cos(view.turn), s = Math.sin(view.turn), high = Math.sin(view.tilt), flat = Math.cos(view.tilt);
    axes = [[c, s, 0], [-s * high, c * high, flat], [-s * flat, c * flat, -high]] // right, up, away
      .map((axis) => data.upright.map((row) => dot(row, axis)));
    centre = [now.x, now.y, 0.12 * long + elevation(now.x, now.y)];
    scale = view.zoom * Math.min(canvas.width / 1.6, canvas.height / 1.1) / long;
    drawGround(now, pixel, ink);
    const parts = [];
    let contacts = now.row * touches.length / frames;
    for (const shape of data.shapes) {
      const element = now.elements[shape.element];
      if (shape.ends) {
        const ends = shape.ends.map((end) => place(element, end));
        parts.push([ends, () => line(...ends, ink, 2 * shape.radius * scale)]);
        continue;
      }
      const at = place(element, shape.centre), touching = shape.touching && touches[contacts++];
      pen.fillStyle = touching ? contact : "#0002";
      const rows = [0, 1].map((i) => [0, 1, 2].map((j) => dot(element.turn[i], shape.axes.map((row) => row[j]))));
      if (touching) spot(at[0], at[1], [0.005, 0.005, 0]);
      else if (shape.opacity < 1) spot(at[0], at[1], ellipse(...rows)); // its shadow
      parts.push([[at, at], () => drawEllipsoid(shape, element, touching, ink)]);
    }
    data.springs.forEach((spring, number) => {
      const ends = spring.map(([element, ...point]) => place(now.elements[element], point));
      const colour = data.palette[heat[now.row * data.springs.length + number]];
      parts.push([ends, () => line(...ends, colour, Math.max(0.002 * scale, 2 * pixel))]);
    });
    const depth = ([a, b]) => project(a).depth + project(b).depth;
    pen.lineCap = "round";
    parts.map(([ends, paint]) => [depth(ends), paint]).sort((a, b) => b[0] - a[0]).forEach(([, paint]) => paint());
    const time = data.duration_s - (last - frame) * data.interval_s, distance = 1000 * (now.x - data.start_m);
    find("readout").textContent = `${time.toFixed(1)} s   ${Math.round(distance)} mm   ${now.energy.toFixed(0)} J`;
    slider.value = frame;
    play.textContent = playing ? "Pause" : "Play";
  }

  function redraw() {
    if (!queued) requestAnimationFrame(draw);
    queued = true;
  }

  function tick(time) {
    if (!playing) return;
    const elapsed = Math.max(time - before, 0); // `before` may be later than the start of the frame
    frame = Math.min(frame + speed.value * elapsed / 1000 / data.interval_s, last);
    before = time;
    playing = frame < last;
    draw();
    next = requestAnimationFrame(tick);
  }

  function toggle() {
    playing = !playing;
    if (playing && frame >= last) frame = 0;
    before = performance.now();
    cancelAnimationFrame(next); // of a tick that is still pending after a pause
    if (playing) next = requestAnimationFrame(tick);
    draw();
  }

  function change({ turn = 0, tilt = 0, zoom = 1 }) {
    view.turn += turn;
    view.tilt = clamp(view.tilt + tilt, 0.03, Math.PI / 2);
    view.zoom = clamp(view.zoom * zoom, 0.4, 8);
    redraw();
  }

  function seek(to) {
    playing = false;
    frame = clamp(to, 0, last);
    redraw();
  }

  const keys = {
    " ": toggle, ArrowLeft: () => change({ turn: -0.1 }), ArrowRight: () => change({ turn: 0.1 }),
    ArrowUp: () => change({ tilt: 0.1 }), ArrowDown: () => change({ tilt: -0.1 }),
    "+": () => change({ zoom: 1.2 }), "-": () => change({ zoom: 1 / 1.2 }),
    ",": () => seek(Math.ceil(frame) - 1), ".": () => seek(Math.floor(frame) + 1),
    Home: () => { view = { ...homeView }; redraw(); },
  };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });

  // Drag to turn. Two fingers turn, tilt and zoom; a finger that moves up or down scrolls the page.
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, event);
    canvas.setPointerCapture(event.pointerId);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const old = pointers.get(event.pointerId);
    if (!old) return;
    const others = [...pointers.values()].filter((pointer) => pointer !== old), count = others.length + 1;
    const apart = (pointer) => Math.hypot(pointer.clientX - others[0].clientX, pointer.clientY - others[0].clientY);
    const zoom = others.length ? apart(event) / Math.max(apart(old), 1) : 1;
    pointers.set(event.pointerId, event);
    change({ turn: -0.01 * (event.clientX - old.clientX) / count, tilt: 0.01 * (event.clientY - old.clientY) / count, zoom });
  });
  canvas.addEventListener("wheel", (event) => { // without a click before, the wheel scrolls the page
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    change({ zoom: Math.exp(-0.002 * event.deltaY) });
  }, { passive: false });

  play.addEventListener("click", toggle);
  slider.max = last;
  slider.addEventListener("input", () => seek(Number(slider.value)));
  new ResizeObserver(redraw).observe(canvas);
  for (const query of ["(prefers-color-scheme: dark)", "print"]) {
    window.matchMedia(query).addEventListener("change", redraw);
  }
})();
