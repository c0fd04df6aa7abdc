'use strict';
(() => {
const $ = id => document.getElementById(id);
const data = JSON.parse($('data').textContent);
const items = [...document.querySelectorAll('script.item')].map(e => JSON.parse(e.textContent));
const maps = items.filter(item => item.kind === 'map');
const meshItem = items.find(item => item.kind === 'mesh');
const previewItem = items.find(item => item.kind === 'preview');
const isBake = data.program !== 'bisque-compare';

// ---- elements and texts ----

function el(name, attributes = {}, ...children) {
  const e = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) e.setAttribute(key, value);
  e.append(...children);
  return e;
}
const row = (name, ...values) => el('tr', {}, el('th', {scope: 'row'}, name),
  ...values.map(value => el('td', {class: 'number'}, value)));
const count = n => n.toLocaleString('en-US');
const plural = (n, one, many) => `${count(n)} ${n === 1 ? one : many}`;
const number = v => v === null ? '∞' : Number(v.toPrecision(4)).toString();
const percent = (part, whole) => `${whole > 0 ? (100 * part / whole).toFixed(2) : 0} %`;
const seconds = s => s < 100 ? `${s.toFixed(2)} s` : `${Math.floor(s / 60)} min ${Math.round(s % 60)} s`;
function size(bytes) {
  const units = ['B', 'KiB', 'MiB', 'GiB', 'TiB'];
  let i = 0;
  for (; bytes >= 1024 && i < 4; i++) bytes /= 1024;
  return `${bytes.toFixed(i ? 1 : 0)} ${units[i]}`;
}
const fileName = path => String(path).split('/').pop();
const quote = word => /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`;

// ---- pictures ----

const url = item => `data:image/png;base64,${item.data}`;
function load(item) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => reject(new Error(`the picture ${item.kind} ${item.name ?? ''} cannot be decoded`));
    image.src = url(item);
  });
}
function pixels(image, width = image.width, height = image.height) {
  const context = Object.assign(document.createElement('canvas'), {width, height})
    .getContext('2d', {willReadFrequently: true});
  context.drawImage(image, 0, 0, width, height);
  return context.getImageData(0, 0, width, height).data;
}

// ---- UDIM tiles, and objects or materials with maps of their own ----

const tiles = data.tiles ?? [];
// The materials of the mesh have these names.
const tileName = tile => `${(tile.material ?? tile.object ?? 'tile').slice(0, 60)} ${tile.tile}`;
for (const map of maps)
  map.tile = Math.max(0, tiles.findIndex(tile => Object.values(tile.maps).includes(map.path)));
const title = map => tiles.length > 1 ? `${map.name}, ${tileName(tiles[map.tile])}` : map.name;

// ---- the head ----

function showHead() {
  const misses = data.samples ? data.misses / data.samples : 0;
  const list = [];
  if (isBake) {
    $('title').textContent = data.mesh_paths.map(fileName).join(', ');
    $('summary').textContent = `${plural(data.low_triangles, 'triangle', 'triangles')} · from ` +
      `${data.scan_paths.map(fileName).join(', ')} · ${data.width} × ${data.height}` +
      `${tiles.length > 1 ? ` · ${tiles.length} sets of maps` : ''} · ${data.samples_per_axis} × ` +
      `${data.samples_per_axis} samples a texel · ${seconds(data.cost.seconds)} on ${data.device}`;
    list.push([misses > 0.05 ? 'bad' : misses > 0.005 ? 'fair' : 'good',
      misses > 0 ? `${percent(data.misses, data.samples)} of the samples found no surface`
        : 'every sample found the surface']);
    if (data.unseen)
      list.push([data.unseen.area_within_mesh > 0.05 ? 'fair' : 'good',
        `${percent(data.unseen.area_within_mesh, 1)} of the scan inside the mesh's bounds was not reached`]);
  } else {
    $('title').textContent = `${fileName(data.a_path)} against ${fileName(data.b_path)}`;
    $('summary').textContent = `${plural(data.compared, 'texel', 'texels')} of ${data.width} × ` +
      `${data.height} compared as ${data.type}`;
    list.push([data.within_limits ? 'good' : 'bad', data.within_limits ? 'all limits hold' : 'a limit does not hold']);
    list.push(['good', `mean ${number(data.mean)}, 99th percentile ${number(data.p99)} ${data.unit}`]);
  }
  list.push(data.warnings.length ? ['fair', plural(data.warnings.length, 'warning', 'warnings')] : ['good', 'no warnings']);
  $('verdict').append(...list.map(([grade, text]) => el('li', {class: grade}, text)));
  document.title = `${$('title').textContent} – Bisque`;
}

// ---- maps ----

// What 0 or 1 of a channel of the picture stands for, as text.
function endText(map, end, channel) {
  const encoding = (data.encodings ?? {})[map.name];
  const value = map.range[channel][end];
  if (!encoding) return number(value);
  const last = Math.min(channel, encoding.scale.length - 1);
  return `${number(value * encoding.scale[last] + encoding.offset[last])}`;
}

function drawHistogram(canvas, counts, map) {
  const context = canvas.getContext('2d'), colors = ['#d0524a', '#3f9a5b', '#4a7fd0'];
  // The largest bin may hold a background, so the scale follows the others.
  const top = Math.max(1, ...counts.map(bins => [...bins].sort((a, b) => b - a)[2]));
  canvas.width = 256;
  canvas.height = 64;
  context.globalCompositeOperation = map.channels > 1 ? 'lighter' : 'source-over';
  counts.forEach((bins, channel) => {
    context.fillStyle = map.channels > 1 ? colors[channel] : '#8a8f98';
    bins.forEach((n, x) => context.fillRect(x, 64 - Math.min(64, 60 * n / top), 1, 64));
  });
}

// Counts the values of texels in charts.
function histogram(image, map, charts) {
  const values = pixels(image), counts = Array.from({length: map.channels > 1 ? 3 : 1}, () => Array(256).fill(0));
  const inside = charts && pixels(charts, image.width, image.height);
  for (let i = 0; i < values.length; i += 4)
    if (!inside || inside[i] + inside[i + 1] > 127)
      counts.forEach((bins, channel) => bins[values[i + channel]]++);
  return counts;
}

async function showMap(map, charts) {
  const image = await load(map), canvas = el('canvas', {class: 'histogram', role: 'img',
    'aria-label': `How often values of ${title(map)} occur`});
  const unit = (data.encodings ?? {})[map.name]?.unit;
  const channel = map.channels > 1 ? 'RGB' : '';
  const range = [0, 1, 2].slice(0, channel ? 3 : 1).map(k =>
    `${channel && channel[k] + ' '}${endText(map, 0, k)} to ${endText(map, 1, k)}`).join(', ');
  image.alt = `The map ${title(map)}`;
  drawHistogram(canvas, histogram(image, map, charts), map);
  map.image = image;
  $('maps').append(el('article', {class: 'card'}, image, el('div', {}, el('h3', {}, title(map)),
    el('p', {}, `${fileName(map.path)} · ${map.width} × ${map.height}`), canvas,
    el('p', {class: 'ends'}, el('span', {}, map.channels > 1 ? '0' : endText({...map, range: map.shown}, 0, 0)),
      el('span', {}, map.channels > 1 ? '1' : endText({...map, range: map.shown}, 1, 0))),
    el('p', {}, `Range: ${range}${unit ? ` (${unit})` : ''}`))));
}

function showMisses(item, image) {
  const canvas = el('canvas', {width: image.width, height: image.height, role: 'img',
    'aria-label': 'Charts grey, texels without a surface red'});
  const context = canvas.getContext('2d');
  context.drawImage(image, 0, 0);
  const picture = context.getImageData(0, 0, image.width, image.height), p = picture.data;
  for (let i = 0; i < p.length; i += 4) {
    const missed = p[i], hit = p[i + 1];
    // A single texel that missed must be seen in a small picture.
    const red = missed > 0 ? Math.max(missed, 128) : 0;
    p[i] = 32 + hit * 0.45 + red * 0.75;
    p[i + 1] = p[i + 2] = 32 + hit * 0.45 * (1 - red / 255);
  }
  context.putImageData(picture, 0, 0);
  $('misses').append(el('article', {class: 'card'}, canvas,
    el('div', {}, el('h3', {}, tiles.length > 1 ? tileName(tiles[item.tile]) : 'UV charts'))));
}

// ---- the asset in 3D ----

const vertexShader = `
precision highp float;
attribute vec3 position, normal; attribute vec4 tangent; attribute vec2 uv;
uniform mat4 modelViewMatrix, projectionMatrix;
varying vec3 n; varying vec4 t; varying vec2 at;
void main() {
  n = normal; t = tangent; at = uv;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
// The lights and the matt surface of bisque-bake's preview.
const fragmentShader = `
precision highp float;
uniform mat3 normalMatrix;
uniform sampler2D colorMap, normalMap, missedMap, shownMap;
uniform bool hasColor, hasNormal, hasMissed, flatMap, objectSpace, greenDown;
varying vec3 n; varying vec4 t; varying vec2 at;
vec3 light(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
vec3 encoded(vec3 c) { return mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }
void main() {
  if (flatMap) { gl_FragColor = vec4(texture2D(shownMap, at).rgb, 1.0); return; }
  vec3 m = 2.0 * texture2D(normalMap, at).rgb - 1.0;
  if (greenDown) m.y = -m.y;
  vec3 turned = !hasNormal ? n : objectSpace ? m : m.x * t.xyz + m.y * t.w * cross(n, t.xyz) + m.z * n;
  vec3 facing = normalize(normalMatrix * turned);
  vec3 key = normalize(vec3(-0.55, 0.65, 0.55)), fill = normalize(vec3(0.85, 0.05, 0.5));
  vec2 found = texture2D(missedMap, at).rg;
  vec3 albedo = mix(hasColor ? light(texture2D(colorMap, at).rgb) : vec3(0.6), vec3(1.0, 0.01, 0.01),
    hasMissed ? found.r / max(found.r + found.g, 0.004) : 0.0);
  float lit = 0.95 * max(dot(facing, key), 0.0) + 0.16 * max(dot(facing, fill), 0.0) + 0.05;
  float shine = 0.06 * pow(max(dot(facing, normalize(key + vec3(0.0, 0.0, 1.0))), 0.0), 32.0);
  gl_FragColor = vec4(encoded(clamp(albedo * lit + shine, 0.0, 1.0)), 1.0);
}`;

class Viewer {
  constructor(canvas, root, images) {
    this.canvas = canvas;
    this.root = root;
    this.images = images;
    this.renderer = new THREE.WebGLRenderer({canvas, antialias: true, alpha: true,
      context: canvas.getContext('webgl2', {antialias: true, alpha: true, preserveDrawingBuffer: true}) ?? undefined});
    this.renderer.setClearAlpha(0);
    this.scene = new THREE.Scene();
    this.scene.add(root);
    this.camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);
    this.upAxis = meshItem.up === 2 ? new THREE.Vector3(0, 0, 1) : new THREE.Vector3(0, 1, 0);
    this.camera.up.copy(this.upAxis);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.enableKeys = false;
    this.textures = new Map();
    this.dress();
    this.controls.addEventListener('change', () => this.draw());
    new ResizeObserver(() => this.draw()).observe(canvas);
  }
  texture(image) {
    if (!this.textures.has(image)) {
      const texture = new THREE.Texture(image);
      texture.flipY = false;
      texture.anisotropy = 4;
      texture.needsUpdate = true;
      this.textures.set(image, texture);
    }
    return this.textures.get(image);
  }
  // Gives each part of the mesh a material, and lines for its edges.
  dress() {
    this.parts = [];
    this.points = [];
    this.root.updateMatrixWorld(true);
    this.root.traverse(part => {
      if (!part.isMesh) return;
      const place = part.geometry.attributes.position;
      for (let i = 0; i < place.count; i++)
        this.points.push(new THREE.Vector3().fromBufferAttribute(place, i).applyMatrix4(part.matrixWorld));
      const tile = tiles.findIndex(t => tileName(t) === part.material.name);
      part.material = new THREE.RawShaderMaterial({vertexShader, fragmentShader, side: THREE.DoubleSide,
        polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1, uniforms: {}});
      const lines = new THREE.LineSegments(new THREE.WireframeGeometry(part.geometry),
        new THREE.LineBasicMaterial({color: 0xffb070, transparent: true, opacity: 0.6}));
      this.parts.push({part, lines, tile});
    });
    for (const {part, lines} of this.parts) part.add(lines);
  }
  // Draws with the state of the switches.
  set(state) {
    const find = (tile, name) => this.images.find(map => map.tile === tile && map.name === name)?.image;
    for (const {part, lines, tile} of this.parts) {
      const color = find(tile, 'color'), normal = find(tile, 'normal'), missed = find(tile, ' misses');
      const shown = find(tile, state.show), any = this.images[0]?.image;
      const values = {colorMap: color, normalMap: normal, missedMap: missed, shownMap: shown};
      for (const [name, image] of Object.entries(values))
        part.material.uniforms[name] = {value: image || any ? this.texture(image ?? any) : null};
      Object.entries({hasColor: state.color && color, hasNormal: state.normal && normal,
        hasMissed: state.misses && missed, flatMap: shown, objectSpace: meshItem.object_space,
        greenDown: meshItem.green_down}).forEach(([name, on]) => part.material.uniforms[name] = {value: !!on});
      lines.visible = state.wireframe;
    }
    this.draw();
  }
  axes(index) {
    const {from, above} = previewItem ?? {from: 30, above: 17}, elevation = above * Math.PI / 180;
    const around = (from / 180 + 2 * index / meshItem.views) * Math.PI;
    const turn = (x, y, z) => meshItem.up === 2 ? new THREE.Vector3(x, -z, y) : new THREE.Vector3(x, y, z);
    const [sa, ca, se, ce] = [Math.sin(around), Math.cos(around), Math.sin(elevation), Math.cos(elevation)];
    return {right: turn(ca, 0, -sa), up: turn(-se * sa, ce, -se * ca), toward: turn(ce * sa, se, ce * ca)};
  }
  // Frames the mesh as a view of the preview does.
  look(index) {
    const {right, up, toward} = this.axes(index), target = new THREE.Vector3();
    let span = 0, radius = 0;
    for (const axis of [right, up, toward]) {
      let low = Infinity, high = -Infinity;
      for (const point of this.points) {
        const at = point.dot(axis);
        low = Math.min(low, at);
        high = Math.max(high, at);
      }
      target.addScaledVector(axis, (low + high) / 2);
      if (axis !== toward) span = Math.max(span, high - low);
      radius = Math.max(radius, high - low);
    }
    const half = span / 0.92 / 2 || 1;
    Object.assign(this.camera, {left: -half, right: half, top: half, bottom: -half, zoom: 1,
      near: 0, far: 8 * (radius || 1)});
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(toward, 4 * (radius || 1));
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.draw();
  }
  nearest() {
    const toward = this.camera.position.clone().sub(this.controls.target).normalize();
    let best = 0, most = -2;
    for (let i = 0; i < meshItem.views; i++) {
      const match = this.axes(i).toward.dot(toward);
      if (match > most) [best, most] = [i, match];
    }
    return best;
  }
  turn(across, upwards) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const side = new THREE.Vector3().crossVectors(this.upAxis, offset).normalize();
    offset.applyAxisAngle(this.upAxis, across);
    const angle = offset.angleTo(this.upAxis) - upwards;
    if (angle > 0.05 && angle < Math.PI - 0.05) offset.applyAxisAngle(side.applyAxisAngle(this.upAxis, across), -upwards);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.draw();
  }
  zoom(factor) {
    this.camera.zoom *= factor;
    this.camera.updateProjectionMatrix();
    this.draw();
  }
  draw() {
    const side = this.canvas.clientWidth;
    if (!side) return;
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(side, side, false);
    this.renderer.render(this.scene, this.camera);
    this.onDraw?.(this.nearest());
  }
}

function showScan(image, index, views) {
  const side = (image.width - 8) / 3, canvas = $('scan');
  if (canvas.index === index) return;
  canvas.index = index;
  canvas.width = canvas.height = side;
  canvas.getContext('2d').drawImage(image, 2 * (side + 4), index * (side + 4), side, side, 0, 0, side, side);
  $('scan-caption').textContent = `Scan, view ${index + 1} of ${views}`;
}

async function parseMesh() {
  const text = atob(meshItem.data), bytes = Uint8Array.from(text, c => c.charCodeAt(0));
  return new Promise((resolve, reject) =>
    new THREE.GLTFLoader().parse(bytes.buffer, '', gltf => resolve(gltf.scene), reject));
}

function choice(type, name, value, text, checked) {
  const input = el('input', {type, name, value});
  input.checked = checked;
  return el('label', {}, input, text);
}

async function showAsset(preview, images) {
  $('asset').hidden = false;
  const viewer = new Viewer($('view'), await parseMesh(), images);
  const names = [...new Set(maps.map(map => map.name))];
  const has = name => names.includes(name);
  for (let i = 0; i < meshItem.views; i++) {
    const button = el('button', {'aria-pressed': 'false', 'aria-label': `View ${i + 1}`}, `${i + 1}`);
    button.onclick = () => viewer.look(i);
    $('views').append(button);
  }
  $('shows').append(choice('radio', 'show', '', 'shaded', true),
    ...names.map(name => choice('radio', 'show', name, name, false)));
  const switches = [['normal', 'normal map', has('normal')], ['color', 'colour', has('color')],
    ['wireframe', 'wireframe', false], ['misses', 'misses', data.misses > 0]]
    .filter(([name]) => name === 'wireframe' || name === 'misses' || has(name));
  $('switches').append(...switches.map(([name, text, on]) => choice('checkbox', name, 'on', text, on)));
  const apply = () => {
    const state = {show: document.querySelector('input[name=show]:checked').value};
    for (const input of $('switches').querySelectorAll('input')) state[input.name] = input.checked;
    viewer.set(state);
  };
  $('controls').onchange = apply;
  viewer.onDraw = index => {
    if (preview) showScan(preview, index, meshItem.views);
    [...$('views').querySelectorAll('button')].forEach((button, i) => button.setAttribute('aria-pressed', i === index));
  };
  const keys = {ArrowLeft: () => viewer.turn(-0.1, 0), ArrowRight: () => viewer.turn(0.1, 0),
    ArrowUp: () => viewer.turn(0, 0.1), ArrowDown: () => viewer.turn(0, -0.1), Home: () => viewer.look(0),
    '+': () => viewer.zoom(1.15), '=': () => viewer.zoom(1.15), '-': () => viewer.zoom(1 / 1.15)};
  $('view').onkeydown = event => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    keys[event.key]();
    event.preventDefault();
  };
  apply();
  viewer.look(0);
}

// ---- figures ----

function showLost() {
  const counted = [['misses', 'sample found no surface', 'samples found no surface'],
    ['low_polygons', 'polygon of the low-poly mesh became triangles', 'polygons of the low-poly mesh became triangles'],
    ['degenerate_uv_triangles', 'triangle has no area in UV space', 'triangles have no area in UV space'],
    ['outside_uv_triangles', 'triangle reaches out of the baked tiles', 'triangles reach out of the baked tiles'],
    ['overlapping_samples', 'sample lies in several triangles', 'samples lie in several triangles'],
    ['not_finite', 'texel is NaN or infinite', 'texels are NaN or infinite'],
    ['only_a', 'texel is covered by the map only', 'texels are covered by the map only'],
    ['only_b', 'texel is covered by the reference only', 'texels are covered by the reference only']];
  const lines = [...data.warnings, ...counted.filter(([key]) => data[key] > 0)
    .map(([key, one, many]) => plural(data[key], one, many))];
  $('lost').append(...(lines.length ? lines : ['Nothing.']).map(line => el('li', {}, line)));
}

function showBar(parent, parts, total, text) {
  const colors = ['#9a5a2b', '#c98a4b', '#7d8f69', '#4f7f86', '#5a6f9e', '#8a6a94', '#8d8d8d'];
  const bar = el('div', {class: 'bar'}), table = el('table');
  parts.forEach(([name, value], i) => {
    const color = colors[i % colors.length];
    bar.append(el('span', {style: `width:${100 * value / (total || 1)}%;background:${color}`}));
    table.append(el('tr', {}, el('th', {scope: 'row'}, el('span', {class: 'key', style: `background:${color}`}), name),
      el('td', {class: 'number'}, text(value))));
  });
  parent.append(bar, table);
}

function showCost() {
  const stages = ['open', 'trace', 'padding', 'resolve', 'write', 'preview']
    .map(name => [name, data[`seconds_${name}`] ?? 0]).filter(([, value]) => value >= 0.005);
  const rest = data.cost.seconds - stages.reduce((sum, [, value]) => sum + value, 0);
  showBar($('times'), [...stages, ['other', Math.max(0, rest)]], data.cost.seconds, seconds);
  $('times').append(el('p', {}, `${seconds(data.cost.seconds)} in all with ${plural(data.cost.threads, 'thread', 'threads')}; ` +
    `${seconds(data.cost.seconds_user + data.cost.seconds_system)} of processors`));
  const shares = Object.entries(data.cost.memory_shares_bytes ?? {}).sort((a, b) => b[1] - a[1]);
  const used = data.cost.memory_high_bytes, budget = data.cost.memory_budget_bytes;
  showBar($('memory'), [['used at most', used], ['left of the budget', Math.max(0, budget - used)]], budget, size);
  $('memory').append(el('p', {}, `Resident at most: ${size(data.cost.max_rss_bytes)}, which counts mapped files`));
  if (shares.length) $('memory').append(el('details', {}, el('summary', {}, 'Set aside for each purpose'),
    el('table', {}, ...shares.map(([name, bytes]) => row(name, size(bytes))))));
}

function showCommand() {
  const command = data.command.map(quote).join(' ');
  $('command').textContent = command;
  $('copy').onclick = async () => {
    await navigator.clipboard.writeText(command).catch(() => getSelection().selectAllChildren($('command')));
    $('copy').textContent = 'Copied';
  };
  const text = value => value === null ? '–' : value === true ? 'on' : value === false ? 'off' : `${value}`;
  $('options').append(...[...data.options].sort((a, b) => b[2] - a[2]).map(([name, value, given]) =>
    el('tr', given ? {class: 'given'} : {}, el('th', {scope: 'row'}, name),
      el('td', {}, given && value === null ? 'as in the command' : text(value)))));
  $('foot').textContent = `${data.program} ${data.version}`;
}

// ---- comparisons ----

function showComparison() {
  const find = name => maps.find(map => map.name === name), heat = items.find(item => item.kind === 'error');
  $('comparison').hidden = !find('A');
  if (!find('A')) return;
  $('image-a').src = url(find('A'));
  $('image-b').src = url(find('B'));
  $('name-a').textContent = data.a_path;
  $('name-b').textContent = `${data.b_path} (reference)`;
  $('split').oninput = () => document.querySelector('.slider').style.setProperty('--split', `${$('split').value}%`);
  const figures = [['mean', data.mean], ['root mean square', data.rms], ['median', data.median],
    ['95th percentile', data.p95], ['99th percentile', data.p99], ['maximum', data.max]];
  $('figures').append(...figures.map(([name, value]) => row(name, `${number(value)} ${data.unit}`)),
    row('maximum at', `${data.max_x}, ${data.max_y}`), row('above 1', percent(data.share_above_1, 1)),
    row('above 5', percent(data.share_above_5, 1)), ...('psnr' in data ? [row('PSNR', `${number(data.psnr)} dB`)] : []));
  if (heat) $('heat').append(el('img', {src: url(heat), alt: 'The error of each texel'}),
    el('figcaption', {}, `Error of each texel, in ${data.unit}`));
}

// ---- all ----

async function main() {
  showHead();
  showLost();
  showCost();
  showCommand();
  const missed = items.filter(item => item.kind === 'misses');
  for (const item of missed) item.image = await load(item);
  for (const map of maps) await showMap(map, missed.find(item => item.tile === map.tile)?.image);
  if (!isBake) return showComparison();
  missed.forEach(item => showMisses(item, item.image));
  $('missing').hidden = missed.length === 0;
  $('missing-text').textContent = data.misses > 0 ? `${plural(data.misses, 'sample', 'samples')} of ` +
    `${count(data.samples)}, in red. Rays reached ${number(data.front)} in front of the mesh and ${number(data.back)} behind it.`
    : `All ${count(data.samples)} samples found the scan.`;
  const preview = previewItem && await load(previewItem);
  if (window.THREE && meshItem && document.createElement('canvas').getContext('webgl'))
    return showAsset(preview, [...maps, ...missed.map(item => ({...item, name: ' misses'}))]);
  $('pictures').hidden = !preview;
  if (preview) $('preview').src = url(previewItem);
  $('no3d').textContent = !window.THREE ? 'Install the package libjs-three to see the asset in 3D in the next report.'
    : 'This browser does not draw in 3D.';
}
main().then(() => document.body.dataset.ready = 'yes')
  .catch(error => { document.body.dataset.ready = 'failed'; console.error(error); });
})();
