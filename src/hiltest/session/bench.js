// The operator's page: asks the run for news, draws them, and sends answers.
"use strict";
const NEWS_MS = 250, LOST_AFTER = 8, TAU = 2 * Math.PI;
const at = id => document.getElementById(id);
const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
let news = {question: 0, asks: false}, shown = 0, unanswered = 0, stopped = false;

async function answer(text) {
  if (!news.asks && text !== "quit") return;
  stopped = text === "quit";
  const body = JSON.stringify({question: news.question, answer: text});
  news.asks = false;
  enable();
  await fetch("answer", {method: "POST", body}).catch(() => undefined);
}

function enable() {
  for (const button of document.querySelectorAll("button")) button.disabled = !news.asks;
  at("stop").disabled = stopped;
  at("enter").textContent = news.asks ? "Enter" : stopped ? "stopping" : "measuring";
}

function words(question) {
  const lines = (question.lines || []).filter(line => !/^Enter\b.*\bq$/.test(line));
  at("request").textContent = lines.length ? lines[lines.length - 1] : "";
  at("notes").replaceChildren(...lines.slice(0, -1).map(line => Object.assign(document.createElement("p"), {textContent: line})));
  at("reached").hidden = !question.takes_heading;
  at("reached").querySelector("input").value = "";
  at("wishes").replaceChildren(...(question.wishes || []).map(wish => {
    const button = Object.assign(document.createElement("button"), {type: "button", textContent: wish});
    button.addEventListener("click", () => answer(wish));
    return button;
  }));
}

function degrees(angle) {
  return typeof angle === "number" ? `${angle > 0.5 ? "+" : ""}${Math.round(angle) || 0} deg` : "unknown";
}

function show() {
  if (news.question !== shown && news.asks) {
    shown = news.question;
    words(news);
  }
  if (!news.asks && news.progress) {
    at("request").textContent = news.progress;
    at("notes").replaceChildren();
  }
  enable();
  at("live").textContent = news.asks ? news.live || "" : "";
  at("still").textContent = news.board ? news.moves ? "moving" : "still" : "unknown";
  at("noise").textContent = news.noise || "unknown";
  at("asked").textContent = degrees(news.asked_deg);
  at("turned").textContent = degrees(news.turned_deg);
  at("turned").className = news.is_wrong_turn ? "fail" : "";
  at("sphere").hidden = !news.sphere;
  document.querySelector("main").classList.toggle("tumbles", !news.ghost);
  if (news.sphere) {
    at("hole").textContent = news.sphere.words;
    drawSphere(at("sphere").querySelector("canvas"), news.sphere);
  }
  drawBoard(at("view").querySelector("canvas"));
  if (news.ended) {
    at("verdict").hidden = false;
    at("verdict").className = `verdict ${news.ended.tone}`;
    at("verdict").querySelector("h1").textContent = news.ended.outcome.toUpperCase();
    at("verdict").querySelector("p").textContent = news.ended.sentence.replace(/^[A-Z ]+[.:] /, "");
    words({});
    at("enter").hidden = at("answers").hidden = at("live").hidden = true;
    keepReport();
  }
}

// The server ends with the run: the browser keeps the report.
async function keepReport() {
  const page = await (await fetch("report.html")).blob();
  at("report").href = URL.createObjectURL(page);
  at("report").hidden = false;
}

function canvasOf(canvas) {
  const scale = devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = box.width * scale;
  canvas.height = box.height * scale;
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  return [context, box.width, box.height];
}

// Seen from above the south: east is right, north is up and away. Returns x, y and the distance.
function project([north, east, down]) {
  const sin = Math.sin(0.7), cos = Math.cos(0.7);
  return [east, -(north * sin - down * cos), north * cos + down * sin];
}

// v_ned = transpose(rows) v_body
const toEarth = (rows, v) => [0, 1, 2].map(k => rows[0][k] * v[0] + rows[1][k] * v[1] + rows[2][k] * v[2]);
const BOX = [1, 0.62, 0.09];
const FACES = [[0, 1], [0, -1], [1, 1], [1, -1], [2, 1], [2, -1]].map(([axis, sign]) => {
  const [p, q] = [0, 1, 2].filter(other => other !== axis);
  return {name: axis === 2 ? sign < 0 ? "top" : "underside" : axis === 0 && sign > 0 ? "nose" : "side",
    corners: [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([a, b]) => {
      const corner = [0, 0, 0];
      corner[axis] = sign * BOX[axis]; corner[p] = a * BOX[p]; corner[q] = b * BOX[q];
      return corner;
    })};
});
const ARROW = [[0.8, 0], [0.2, 0.35], [0.2, 0.12], [-0.7, 0.12], [-0.7, -0.12], [0.2, -0.12], [0.2, -0.35]];

function drawBoard(canvas) {
  const [context, width, height] = canvasOf(canvas), size = Math.min(width, height * 1.2) / 3.1;
  const place = v => { const [x, y] = project(v); return [width / 2 + size * x, height / 2 + size * y]; };
  const polygon = (points, fill, stroke, dashes = []) => {
    context.beginPath();
    points.map(place).forEach(([x, y], index) => index ? context.lineTo(x, y) : context.moveTo(x, y));
    context.closePath();
    context.setLineDash(dashes);
    if (fill) { context.fillStyle = fill; context.fill(); }
    if (stroke) { context.strokeStyle = stroke; context.stroke(); }
  };
  const ring = Array.from({length: 73}, (_, k) => [1.35 * Math.cos(k * TAU / 72), 1.35 * Math.sin(k * TAU / 72), 0]);
  context.lineWidth = 1;
  polygon(ring, null, colour("rule"));
  context.fillStyle = colour("soft");
  context.font = "14px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const [name, v] of [["N", [1.5, 0, 0]], ["E", [0, 1.5, 0]], ["S", [-1.5, 0, 0]], ["W", [0, -1.5, 0]]]) context.fillText(name, ...place(v));
  const solid = (rows, paint) => {
    const faces = FACES.map(face => ({...face, points: face.corners.map(corner => toEarth(rows, corner))}));
    const depth = face => face.points.reduce((sum, v) => sum + project(v)[2], 0);
    faces.sort((a, b) => depth(b) - depth(a)).forEach(paint);
    return faces.slice(3);
  };
  const arrow = (rows, up) => ARROW.map(([x, y]) => toEarth(rows, [x * BOX[0], y * BOX[1], up]));
  if (news.board) {
    const tints = {top: "good-page", underside: "warn-page", nose: "other", side: "track"};
    const front = solid(news.board, face => polygon(face.points, colour(tints[face.name]), colour("ink")));
    if (front.some(face => face.name === "top")) polygon(arrow(news.board, -BOX[2]), colour("other"));
    context.fillStyle = colour("other");
    context.fillText("nose", ...place(toEarth(news.board, [1.22, 0, 0])));
  }
  if (news.ghost && news.asks) {
    context.lineWidth = 2;
    solid(news.ghost, face => polygon(face.points, null, colour("accent"), [5, 4]));
    polygon(arrow(news.ghost, -BOX[2]), null, colour("accent"), [5, 4]);
    context.fillStyle = colour("accent");
    context.fillText("wanted", ...place(toEarth(news.ghost, [0, 1, 0])));
  }
  context.setLineDash([]);
}

// Two hemispheres in Lambert's equal areas: the top as seen from above, the underside from below, the nose up in both.
function drawSphere(canvas, sphere) {
  const [context, width, height] = canvasOf(canvas), radius = Math.min(width / 4, height / 2) - 22;
  const middles = [width / 4, 3 * width / 4];
  const disc = ([x, y, z]) => {
    const below = z > 0 ? 1 : 0, along = Math.hypot(x, y) || 1, out = radius * Math.sqrt(1 - Math.abs(z)) / along;
    return [middles[below] + (below ? -1 : 1) * out * y, height / 2 - out * x];
  };
  context.font = "13px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  ["top", "underside"].forEach((name, index) => {
    context.beginPath();
    context.arc(middles[index], height / 2, radius, 0, TAU);
    context.fillStyle = colour("page");
    context.fill();
    context.strokeStyle = colour("rule");
    context.stroke();
    context.fillStyle = colour("soft");
    context.fillText("nose", middles[index], height / 2 - radius - 11);
    context.fillText(name, middles[index], height / 2 + radius + 11);
  });
  const dot = (v, size, fill) => {
    const [x, y] = disc(v);
    context.fillStyle = fill;
    context.fillRect(x - size / 2, y - size / 2, size, size);
  };
  if (sphere.hole) {
    // The hole is filled with dots that are spread evenly over the sphere.
    context.globalAlpha = 0.3;
    const edge = Math.cos(sphere.radius_deg * TAU / 360);
    for (let k = 0; k < 3000; k++) {
      const z = 1 - (2 * k + 1) / 3000, across = Math.sqrt(1 - z * z), turn = k * 2.399963;
      const v = [across * Math.cos(turn), across * Math.sin(turn), z];
      if (v[0] * sphere.hole[0] + v[1] * sphere.hole[1] + v[2] * sphere.hole[2] > edge) dot(v, 6, colour("bad"));
    }
    context.globalAlpha = 1;
  }
  for (const v of sphere.points) dot(v, 4, colour("accent"));
}

async function ask() {
  try {
    news = await (await fetch("state", {cache: "no-store"})).json();
    unanswered = 0;
    show();
  } catch {
    if (++unanswered > LOST_AFTER) {
      news.asks = false;
      enable();
      at("request").textContent = "The run does not answer any more: see its terminal.";
    }
  }
  if (!news.ended) setTimeout(ask, NEWS_MS);
}

at("enter").addEventListener("click", () => answer(at("reached").querySelector("input").value.trim()));
at("stop").addEventListener("click", () => answer("quit"));
at("answers").addEventListener("submit", event => {
  event.preventDefault();
  answer(at("reached").querySelector("input").value.trim());
});
addEventListener("keydown", event => {
  const isOwn = event.target.matches("input, button:not(#enter), summary");
  if (isOwn || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  const wish = (news.wishes || []).find(word => word[0] === event.key);
  if (event.key === "Enter") { event.preventDefault(); answer(at("reached").querySelector("input").value.trim()); }
  else if (wish) answer(wish);
  else if (event.key === "q" && (news.wishes || []).length) answer("quit");
  else if (/^[-0-9.]$/.test(event.key) && !at("reached").hidden) at("reached").querySelector("input").focus();
});
ask();
