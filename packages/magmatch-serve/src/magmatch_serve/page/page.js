// SPDX-License-Identifier: BSD-3-Clause
// The live map: asks the service for its maps and follows what it tells of the bodies. Nothing comes from elsewhere.
"use strict";
const $ = id => document.getElementById(id);
// Places of a body's past that are drawn, and path between two, m: the last 20 m.
const MAX_TRAIL = 200, TRAIL_STEP = 0.1, SIGMAS = 2.45;
const VIRIDIS = ["#440154", "#482878", "#3e4a89", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"];
const WORDS = { localized: "localized", dead_reckoning: "dead reckoning", searching: "searching", lost: "lost" };
let token = "", version = "", names = [], picture = null, image = null, bodies = [], chosen = null, pause = 500;
let hasChosenMap = false;
const trails = new Map();

const ask = async path => {
  const answer = await fetch(path, token ? { headers: { Authorization: `Bearer ${token}` } } : {});
  if (answer.status === 401) { askForToken(); throw new Error("the token is missing or wrong"); }
  if (!answer.ok) throw new Error((await answer.json()).message);
  return answer.json();
};
const askForToken = () => { $("door").hidden = false; $("token").focus(); };
const say = words => { if ($("state").textContent !== words) $("state").textContent = words; };

const begin = async () => {
  try {
    await loadMaps();
    $("door").hidden = true;
    follow();
  } catch (error) {
    say(error.message);
    if ($("door").hidden) setTimeout(begin, 3000);
  }
};

const loadMaps = async () => {
  const listed = await ask("/maps");
  version = listed.version;
  names = listed.maps.map(m => m.name);
  const before = $("maps").value;
  $("maps").replaceChildren(...names.map(name => new Option(name, name)));
  show(names.includes(before) ? before : names[0]);
};

// Nobody waits for a picture; one that does not come is asked for again, while its map is chosen.
const show = async name => {
  $("maps").value = name;
  if (picture && picture.name !== name) { picture = null; draw(); }
  const asked = version;
  let found;
  try {
    found = await ask(`/maps/${encodeURIComponent(name)}`);
  } catch (error) {
    setTimeout(() => { if ($("maps").value === name && asked === version) show(name); }, 3000);
    return;
  }
  if ($("maps").value !== name || asked !== version) return;
  picture = found;
  const known = picture.field_ut.flat().filter(v => v !== null).sort((a, b) => a - b);
  const low = known[Math.floor(0.02 * known.length)] ?? 0, high = known[Math.floor(0.98 * (known.length - 1))] ?? 1;
  $("low").textContent = low.toFixed(1); $("high").textContent = high.toFixed(1);
  const [rows, columns] = picture.shape;
  image = document.createElement("canvas");
  image.width = columns; image.height = rows;
  const pixels = image.getContext("2d"), data = pixels.createImageData(columns, rows);
  picture.field_ut.forEach((row, j) => row.forEach((v, i) => {
    if (v === null) return;
    const [r, g, b] = colour((v - low) / Math.max(high - low, 1e-9));
    data.data.set([r, g, b, 255], 4 * ((rows - 1 - j) * columns + i));
  }));
  pixels.putImageData(data, 0, 0);
  draw();
};

const colour = share => {
  const x = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1), k = Math.min(Math.floor(x), VIRIDIS.length - 2);
  const at = (text, n) => parseInt(text.slice(1 + 2 * n, 3 + 2 * n), 16);
  return [0, 1, 2].map(n => at(VIRIDIS[k], n) + (x - k) * (at(VIRIDIS[k + 1], n) - at(VIRIDIS[k], n)));
};

const follow = () => {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/watch`,
                               token ? ["magmatch.1", `bearer.${token}`] : ["magmatch.1"]);
  socket.onmessage = event => {
    pause = 500;
    const said = JSON.parse(event.data);
    if (said.version !== version) { version = said.version; loadMaps().catch(error => say(error.message)); }
    bodies = said.bodies;
    for (const body of bodies) remember(body);
    tell(); draw();
  };
  socket.onclose = () => {
    say("The service does not answer; trying again");
    setTimeout(begin, pause);
    pause = Math.min(2 * pause, 10000);
  };
};

const remember = body => {
  if (body.trail) trails.set(body.client, body.trail);
  if (!body.T_map_body) return;
  const trail = trails.get(body.client) ?? [], [x, y] = [body.T_map_body[0][3], body.T_map_body[1][3]];
  const last = trail.at(-1);
  if (!last || Math.hypot(x - last[0], y - last[1]) > TRAIL_STEP) trail.push([x, y, body.map ?? ""]);
  if (trail.length > MAX_TRAIL) trail.shift();
  trails.set(body.client, trail);
  // The map of whoever is found first, until another is chosen.
  if (!hasChosenMap && names.length > 1 && names.includes(body.map) && $("maps").value !== body.map) {
    hasChosenMap = true;
    show(body.map);
  }
};

const tell = () => {
  const n = bodies.filter(b => b.is_here).length;
  say(`${n} ${n === 1 ? "client is" : "clients are"} connected`);
  $("nobody").hidden = bodies.length > 0;
  // Buttons are kept, so that the keyboard's focus stays where it is.
  const list = $("bodies"), kept = new Map([...list.children].map(item => [item.dataset.client, item]));
  for (const [client, item] of kept) if (!bodies.some(b => b.client === client)) item.remove();
  for (const body of bodies) {
    let item = kept.get(body.client);
    if (!item) {
      item = document.createElement("li");
      item.dataset.client = body.client;
      const button = document.createElement("button");
      button.append(document.createElement("strong"), " ", document.createElement("span"), document.createElement("small"));
      button.onclick = () => { chosen = chosen === body.client ? null : body.client; tell(); draw(); };
      item.append(button);
      list.append(item);
    }
    const button = item.firstChild, [name, , status, why] = button.childNodes;
    button.className = `${body.status} ${body.is_here ? "" : "away"}`;
    button.setAttribute("aria-pressed", chosen === body.client);
    name.textContent = body.name || body.client;
    status.textContent = (WORDS[body.status] ?? body.status) + (body.is_here ? "" : ", gone");
    const T = body.T_map_body;
    const where = T ? `x ${T[0][3].toFixed(2)}, y ${T[1][3].toFixed(2)}, z ${T[2][3].toFixed(2)} m${names.length > 1 ? ` in ${body.map}` : ""}. ` : "";
    why.textContent = where + body.reason;
  }
};

const isOnMap = map => names.length === 1 || map === $("maps").value;

const draw = () => {
  const canvas = $("map"), box = canvas.getBoundingClientRect(), ratio = devicePixelRatio || 1;
  canvas.width = Math.round(box.width * ratio); canvas.height = Math.round(box.height * ratio);
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  const style = getComputedStyle(document.documentElement), of = name => style.getPropertyValue(`--${name}`).trim();
  if (!picture) {
    pen.fillStyle = of("quiet"); pen.font = "16px system-ui, sans-serif"; pen.textAlign = "center";
    pen.fillText("The map is being drawn", box.width / 2, box.height / 2);
    return;
  }
  const [x0, x1] = picture.x, [y0, y1] = picture.y, margin = 18;
  const scale = Math.min((box.width - 2 * margin) / (x1 - x0), (box.height - 2 * margin) / (y1 - y0));
  if (scale <= 0) return; // no room within the margins
  const left = (box.width - scale * (x1 - x0)) / 2, top = (box.height - scale * (y1 - y0)) / 2;
  const at = (x, y) => [left + scale * (x - x0), top + scale * (y1 - y)];
  pen.imageSmoothingEnabled = true;
  pen.drawImage(image, left, top, scale * (x1 - x0), scale * (y1 - y0));
  drawRuler(pen, box, scale, of("ink"));
  for (const body of bodies) {
    pen.globalAlpha = !body.is_here || (chosen && chosen !== body.client) ? 0.35 : 1;
    drawTrail(pen, at, trails.get(body.client) ?? []);
    for (const [map, x, y, , odds] of body.hypotheses ?? [])
      if (isOnMap(map)) ring(pen, ...at(x, y), 4 + 12 * Math.sqrt(odds));
    if (body.T_map_body && isOnMap(body.map)) drawBody(pen, at, scale, body, of(body.status));
  }
  pen.globalAlpha = 1;
};

// Light over dark, so that lines show on every colour of the field.
const twice = (pen, width, colour, path) => {
  for (const [w, c] of [[width + 3, "#fff"], [width, colour]]) {
    pen.lineWidth = w; pen.strokeStyle = c; pen.beginPath(); path(); pen.stroke();
  }
};
const ring = (pen, x, y, r) => twice(pen, 2, "#1b1f24", () => pen.arc(x, y, r, 0, 2 * Math.PI));

const drawTrail = (pen, at, trail) => {
  twice(pen, 1.5, "#1b1f24", () => {
    let last = null;
    for (const [x, y, map] of trail) {
      if (!isOnMap(map)) { last = null; continue; }
      const isNear = last && Math.hypot(x - last[0], y - last[1]) < 20 * TRAIL_STEP;
      pen[isNear ? "lineTo" : "moveTo"](...at(x, y));
      last = [x, y];
    }
  });
};

const drawBody = (pen, at, scale, body, colour) => {
  const T = body.T_map_body, [x, y] = at(T[0][3], T[1][3]), [[a, b], [, d]] = body.covariance_xy;
  const mean = (a + d) / 2, off = Math.hypot((a - d) / 2, b), angle = 0.5 * Math.atan2(2 * b, a - d);
  const long = SIGMAS * scale * Math.sqrt(Math.max(mean + off, 0)), short = SIGMAS * scale * Math.sqrt(Math.max(mean - off, 0));
  twice(pen, 2, colour, () => pen.ellipse(x, y, long, short, -angle, 0, 2 * Math.PI));
  const [ux, uy] = [T[0][0], -T[1][0]], n = Math.hypot(ux, uy) || 1;
  twice(pen, 3, colour, () => { pen.moveTo(x, y); pen.lineTo(x + 18 * ux / n, y + 18 * uy / n); });
  pen.fillStyle = colour; pen.beginPath();
  if (body.status === "localized") pen.arc(x, y, 6, 0, 2 * Math.PI);
  else { pen.moveTo(x, y - 8); pen.lineTo(x + 8, y); pen.lineTo(x, y + 8); pen.lineTo(x - 8, y); pen.closePath(); }
  pen.fill(); pen.lineWidth = 1.5; pen.strokeStyle = "#fff"; pen.stroke();
  pen.font = "600 14px system-ui, sans-serif"; pen.lineWidth = 4; pen.lineJoin = "round"; pen.strokeStyle = "#fff";
  pen.strokeText(body.name || body.client, x + 12, y - 10);
  pen.fillStyle = "#1b1f24"; pen.fillText(body.name || body.client, x + 12, y - 10);
};

const drawRuler = (pen, box, scale, ink) => {
  const most = box.width / 4 / scale, step = 10 ** Math.floor(Math.log10(most));
  const length = step * (most / step >= 5 ? 5 : most / step >= 2 ? 2 : 1);
  pen.strokeStyle = pen.fillStyle = ink; pen.lineWidth = 2; pen.beginPath();
  pen.moveTo(10, box.height - 8); pen.lineTo(10 + scale * length, box.height - 8); pen.stroke();
  pen.font = "13px system-ui, sans-serif"; pen.fillText(`${length} m`, 12, box.height - 13);
};

$("maps").onchange = () => { hasChosenMap = true; show($("maps").value); };
$("door").onsubmit = event => { event.preventDefault(); token = $("token").value.trim(); begin(); };
$("here").textContent = location.origin;
addEventListener("resize", draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
begin();
