'use strict';
(() => {
const $ = id => document.getElementById(id);
const data = JSON.parse($('data').textContent), tiles = data.tiles ?? [];
const items = [...document.querySelectorAll('script.item')].map(e => JSON.parse(e.textContent));
const all = kind => items.filter(item => item.kind === kind);
const maps = all('map'), missed = all('misses'), [meshItem] = all('mesh'), [previewItem] = all('preview');

// ---- elements, texts and pictures ----

function el(name, attributes = {}, ...children) {
  const e = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) e.setAttribute(key, value);
  e.append(...children);
  return e;
}
const row = (name, ...cells) => el('tr', {}, el('th', {scope: 'row'}, name), ...cells.map(cell => el('td', {}, cell)));
const count = n => n.toLocaleString('en-US');
const number = v => v === null ? '∞' : Number(v.toPrecision(4)).toString();
const percent = share => `${(100 * share).toFixed(2)} %`;
const seconds = s => s < 100 ? `${s.toFixed(2)} s` : `${Math.floor(s / 60)} min ${Math.round(s % 60)} s`;
const mebibytes = bytes => `${(bytes / 2 ** 20).toFixed(1)} MiB`;
const fileName = path => path.split('/').pop();

// Gives an item its image.
async function load(item) {
  item.image = Object.assign(new Image(), {src: `data:image/png;base64,${item.data}`});
  await item.image.decode();
}
function pixels(image) {
  const canvas = el('canvas', {width: image.width, height: image.height}), context = canvas.getContext('2d');
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, image.width, image.height);
}

// The materials of the mesh have the names of their UDIM tiles, or of objects or materials with own maps.
const tileName = tile => `${(tile.material ?? tile.object ?? 'tile').slice(0, 60)} ${tile.tile}`;
const inTile = (name, tile) => tiles.length > 1 ? `${name}, ${tileName(tiles[tile])}` : name;

// ---- maps ----

function drawHistogram(canvas, map, charts) {
  const context = canvas.getContext('2d'), values = pixels(map.image).data;
  const inside = charts && charts.width === map.image.width && pixels(charts).data;
  context.globalCompositeOperation = 'lighter';
  (map.channels > 1 ? ['#d0524a', '#3f9a5b', '#4a7fd0'] : ['#8a8f98']).forEach((color, channel) => {
    const bins = Array(256).fill(0);
    for (let i = 0; i < values.length; i += 4)
      if (!inside || inside[i] + inside[i + 1] > 127) bins[values[i + channel]]++;
    const top = [...bins].sort((a, b) => b - a)[2] || bins.length; // the largest may be a background
    context.fillStyle = color;
    bins.forEach((n, x) => context.fillRect(x, 64, 1, -Math.min(64, 60 * n / top)));
  });
}

function showMap(map) {
  map.tile = Math.max(0, tiles.findIndex(tile => Object.values(tile.maps).includes(map.path)));
  const encoding = data.encodings[map.name], name = inTile(map.name, map.tile), several = map.channels > 1;
  const value = (stored, k) => number(encoding ? stored * encoding.scale[k] + encoding.offset[k] : stored);
  const canvas = el('canvas', {class: 'histogram', width: 256, height: 64, role: 'img',
    'aria-label': `How often values of ${name} occur`});
  map.image.alt = `The map ${name}`;
  drawHistogram(canvas, map, missed.find(item => item.tile === map.tile)?.image);
  const ranges = map.range.slice(0, several ? 3 : 1).map(([low, high], k) =>
    `${several ? 'RGB'[k] + ' ' : ''}${value(low, k)} to ${value(high, k)}`).join(', ');
  const [low, high] = map.range[0], ends = low >= 0 && high <= 1 ? [0, 1] : [low, high]; // black and white
  $('maps').append(el('article', {}, map.image, el('h3', {}, name),
    el('p', {class: 'hint'}, `${fileName(map.path)} · ${map.width} × ${map.height}`), canvas,
    el('p', {class: 'ends'}, ...ends.map(end => el('span', {}, several ? '' : value(end, 0)))),
    el('p', {class: 'hint'}, `Range: ${ranges}${encoding ? ` (${encoding.unit})` : ''}`)));
}

// Shows charts in grey, and texels without a surface in red.
function showMisses(item) {
  item.name = 'missed samples';
  const picture = pixels(item.image), p = picture.data, name = inTile('UV charts', item.tile);
  const canvas = el('canvas', {width: picture.width, height: picture.height, role: 'img', 'aria-label': name});
  for (let i = 0; i < p.length; i += 4) {
    const red = p[i] && Math.max(p[i], 128); // so that a single texel is seen
    p[i + 1] = p[i + 2] = 32 + p[i + 1] * 0.45 * (1 - red / 255);
    p[i] = Math.max(p[i + 1], red);
  }
  canvas.getContext('2d').putImageData(picture, 0, 0);
  $('misses').append(el('article', {}, canvas, el('h3', {}, name)));
}

// ---- the asset in 3D ----

const vertexShader = `
attribute vec4 tangent; varying vec3 n; varying vec4 t; varying vec2 at;
void main() {
  n = normal; t = tangent; at = uv;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
// The lights and the matt surface of bisque-bake's preview.
const fragmentShader = `
uniform mat3 normalMatrix;
uniform sampler2D mapColor, mapNormal, mapMissed, mapShown;
uniform bool hasColor, hasNormal, hasMissed, hasShown, objectSpace, greenDown;
varying vec3 n; varying vec4 t; varying vec2 at;
vec3 light(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
vec3 encoded(vec3 c) { return mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }
void main() {
  if (hasShown) { gl_FragColor = vec4(texture2D(mapShown, at).rgb, 1.0); return; }
  vec3 m = 2.0 * texture2D(mapNormal, at).rgb - 1.0;
  if (greenDown) m.y = -m.y;
  vec3 turned = !hasNormal ? n : objectSpace ? m : m.x * t.xyz + m.y * t.w * cross(n, t.xyz) + m.z * n;
  vec3 facing = normalize(normalMatrix * turned);
  if (!gl_FrontFacing && facing.z < 0.0) facing = -facing;
  vec3 key = normalize(vec3(-0.55, 0.65, 0.55)), fill = normalize(vec3(0.85, 0.05, 0.5));
  vec2 found = texture2D(mapMissed, at).rg;
  vec3 albedo = mix(hasColor ? light(texture2D(mapColor, at).rgb) : vec3(0.6), vec3(1.0, 0.01, 0.01),
    hasMissed ? found.r / max(found.r + found.g, 0.004) : 0.0);
  float lit = 0.95 * max(dot(facing, key), 0.0) + 0.16 * max(dot(facing, fill), 0.0) + 0.05;
  float shine = 0.06 * pow(max(dot(facing, normalize(key + vec3(0.0, 0.0, 1.0))), 0.0), 32.0);
  gl_FragColor = vec4(encoded(clamp(albedo * lit + shine, 0.0, 1.0)), 1.0);
}`;

// Draws the mesh, turned by `around` and `above` in degrees before a camera that looks along -z.
class Viewer {
  constructor(canvas, root) {
    const context = canvas.getContext('webgl2', {antialias: true, preserveDrawingBuffer: true});
    Object.assign(this, {canvas, root, parts: [], scene: new THREE.Scene(), camera: new THREE.OrthographicCamera(),
      renderer: new THREE.WebGLRenderer({canvas, context, alpha: true})});
    this.scene.add(root);
    root.rotation.x = meshItem.up === 2 ? -Math.PI / 2 : 0;
    root.traverse(part => part.isMesh && this.parts.push(part));
    for (const part of this.parts) {
      part.tile = tiles.findIndex(tile => tileName(tile) === part.material.name);
      part.material = new THREE.ShaderMaterial({vertexShader, fragmentShader, side: THREE.DoubleSide,
        uniforms: {objectSpace: {value: meshItem.object_space}, greenDown: {value: meshItem.green_down}},
        polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1});
      part.add(new THREE.LineSegments(new THREE.WireframeGeometry(part.geometry),
        new THREE.LineBasicMaterial({color: 0xffb070, transparent: true, opacity: 0.6})));
    }
    new ResizeObserver(() => this.draw()).observe(canvas);
  }
  // Gives each part its maps, by the state of the switches.
  set(state) {
    const texture = of => of && (of.texture ??= Object.assign(new THREE.Texture(of.image),
      {flipY: false, anisotropy: 4, needsUpdate: true}));
    for (const part of this.parts) {
      const find = name => [...maps, ...missed].find(item => item.tile === part.tile && item.name === name);
      const used = {Color: state.color && find('color'), Normal: state.normal && find('normal'),
        Missed: state.misses && find('missed samples'), Shown: find(state.show)};
      for (const [name, of] of Object.entries(used))
        Object.assign(part.material.uniforms, {[`map${name}`]: {value: texture(of)}, [`has${name}`]: {value: !!of}});
      part.children[0].visible = !!state.wireframe;
    }
    this.draw();
  }
  // Frames the mesh as a view of the preview does, and lets it turn around its middle.
  look(index) {
    const box = new THREE.Box3(), point = new THREE.Vector3();
    this.root.position.set(0, 0, 0);
    this.pose(previewItem.from + previewItem.step * index, previewItem.above);
    this.scene.updateMatrixWorld(true);
    for (const {geometry: {attributes: {position}}, matrixWorld} of this.parts)
      for (let i = 0; i < position.count; i++)
        box.expandByPoint(point.fromBufferAttribute(position, i).applyMatrix4(matrixWorld));
    const size = box.getSize(point.clone());
    this.root.position.copy(this.scene.worldToLocal(box.getCenter(point))).negate();
    const half = Math.max(size.x, size.y) / 0.92 / 2 || 1, far = 2 * size.length() || 1;
    Object.assign(this.camera, {left: -half, right: half, top: half, bottom: -half, zoom: 1, near: -far, far});
    this.draw();
  }
  pose(around, above) {
    Object.assign(this, {around, above});
    this.scene.rotation.set(above * Math.PI / 180, -around * Math.PI / 180, 0);
  }
  turn(around, above, zoom = 1) {
    this.pose(this.around + around, Math.max(-89, Math.min(89, this.above + above)));
    this.camera.zoom *= zoom;
    this.draw();
  }
  draw() {
    const side = this.canvas.clientWidth;
    if (!side || this.above === undefined) return;
    this.camera.updateProjectionMatrix();
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(side, side, false);
    this.renderer.render(this.scene, this.camera);
    const away = index => Math.cos((this.around - previewItem.from - previewItem.step * index) * Math.PI / 180);
    showScan(Array.from({length: meshItem.views}, (_, i) => i).reduce((a, b) => away(b) > away(a) + 1e-9 ? b : a));
  }
}

const choice = (type, name, value, text, checked) =>
  el('label', {}, el('input', {type, name, value, ...(checked ? {checked: ''} : {})}), ` ${text}`);

function showScan(index) {
  const {image} = previewItem, side = (image.width - 8) / 3, canvas = $('scan');
  const row = (image.height + 4) / meshItem.views;
  canvas.width = canvas.height = side;
  canvas.getContext('2d').drawImage(image, 2 * (side + 4), index * row, side, side, 0, 0, side, side);
  $('scan-caption').textContent = `Scan, view ${index + 1} of ${meshItem.views}`;
  [...$('views').querySelectorAll('button')].forEach((e, i) => e.setAttribute('aria-pressed', i === index));
}

async function showAsset() {
  const bytes = Uint8Array.from(atob(meshItem.data), c => c.charCodeAt(0)), view = $('view');
  const gltf = await new Promise((resolve, reject) => new THREE.GLTFLoader().parse(bytes.buffer, '', resolve, reject));
  const viewer = new Viewer(view, gltf.scene), names = [...new Set(maps.map(map => map.name))];
  $('views').append(...Array.from({length: meshItem.views}, (_, i) => Object.assign(
    el('button', {type: 'button', 'aria-label': `View ${i + 1}`}, `${i + 1}`), {onclick: () => viewer.look(i)})));
  $('shows').append(choice('radio', 'show', '', 'shaded', true),
    ...names.map(name => choice('radio', 'show', name, name, false)));
  const switches = [['normal', 'normal map', true], ['color', 'colour', true]].filter(([name]) => names.includes(name));
  switches.push(['wireframe', 'wireframe', false], ['misses', 'misses', data.misses > 0]);
  $('switches').append(...switches.map(([name, text, on]) => choice('checkbox', name, 'on', text, on)));
  $('controls').onchange = () => viewer.set(Object.fromEntries(new FormData($('controls'))));
  const turns = {ArrowLeft: [-6, 0], ArrowRight: [6, 0], ArrowUp: [0, 6], ArrowDown: [0, -6],
    '+': [0, 0, 1.15], '=': [0, 0, 1.15], '-': [0, 0, 1 / 1.15]};
  view.onkeydown = event => {
    if (event.ctrlKey || event.metaKey || !(turns[event.key] || event.key === 'Home')) return;
    turns[event.key] ? viewer.turn(...turns[event.key]) : viewer.look(0);
    event.preventDefault();
  };
  view.onpointerdown = event => view.setPointerCapture(event.pointerId);
  view.onpointermove = event => event.buttons && viewer.turn(-event.movementX / 2, event.movementY / 2);
  view.onwheel = event => {
    viewer.turn(0, 0, Math.exp(-event.deltaY / 1000));
    event.preventDefault();
  };
  $('asset').hidden = false;
  $('controls').onchange();
  viewer.look(0);
}

// ---- figures ----

function showHead() {
  const isBake = 'mesh_paths' in data;
  $('title').textContent = isBake ? data.mesh_paths.map(fileName).join(', ')
    : `${fileName(data.a_path)} against ${fileName(data.b_path)}`;
  $('summary').textContent = isBake ? `${count(data.low_triangles)} triangles · from ` +
    `${data.scan_paths.map(fileName).join(', ')} · ${data.width} × ${data.height} · ${data.samples_per_axis} × ` +
    `${data.samples_per_axis} samples a texel · ${seconds(data.cost.seconds)} on ${data.device}`
    : data.within_limits ? 'All limits hold.' : 'A limit does not hold.';
  document.title = `${$('title').textContent} – Bisque`;
}

function showLost() {
  const counted = ['misses', 'low_polygons', 'degenerate_uv_triangles', 'outside_uv_triangles', 'overlapping_samples',
    'not_finite', 'only_a', 'only_b'].filter(key => data[key] > 0);
  const lines = [...data.warnings, ...counted.map(key => `${key.replaceAll('_', ' ')}: ${count(data[key])}`)];
  $('lost').append(...(lines.length ? lines : ['Nothing.']).map(line => el('li', {}, line)));
}

function showCost() {
  const {cost} = data, used = cost.memory_high_bytes;
  const stages = Object.keys(data).filter(key => key.startsWith('seconds_') && data[key] >= 0.005);
  const bar = key => el('meter', {value: data[key], max: cost.seconds});
  $('cost').append(...stages.map(key => row(key.slice(8), seconds(data[key]), bar(key))),
    row('in all', seconds(cost.seconds), `${cost.threads} threads, ` +
      `${seconds(cost.seconds_user + cost.seconds_system)} of processors`),
    row('memory used at most', mebibytes(used), `of a budget of ${mebibytes(cost.memory_budget_bytes)}`),
    row('resident at most', mebibytes(cost.max_rss_bytes), 'which counts mapped files'));
  const quote = word => /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`;
  $('command').textContent = data.command.map(quote).join(' ');
  $('options').append(...data.options.map(([name, value]) => row(name, `${value ?? '–'}`)));
  $('foot').textContent = `${data.program} ${data.version}`;
}

function showComparison(c, a, b, error) {
  const slider = el('div', {class: 'slider'}, b.image, a.image, el('input', {type: 'range', min: 0, max: 100, step: 0.5,
    'aria-label': 'Where the map ends and the reference begins'}),
    el('p', {class: 'ends hint'}, el('span', {}, c.a_path), el('span', {}, `${c.b_path} (reference)`)));
  slider.oninput = event => slider.style.setProperty('--split', `${event.target.value}%`);
  [a, b, error].forEach(({image}, i) => image.alt = ['The map', 'The reference', 'The error of each texel'][i]);
  const isData = c.type === 'data', unit = isData ? '' : ` ${c.unit}`; // figures of data are in the map's own unit
  const figures = [['texels', count(c.compared)], ...['mean', 'rms', 'median', 'p95', 'p99', 'max'].map(
    key => [key, number(c[key]) + unit]), ['max at', `${c.max_x}, ${c.max_y}`]];
  if (!isData) figures.push(['above 1', percent(c.share_above_1)], ['above 5', percent(c.share_above_5)]);
  if ('psnr' in c) figures.push(['PSNR', `${number(c.psnr)} dB`]);
  $('errors').append(el('article', {class: 'compared'}, slider, el('table', {}, ...figures.map(cells => row(...cells))),
    el('figure', {}, error.image,
      el('figcaption', {}, `Error of each texel, from black, 0, to light yellow, ${number(c.scale)}${unit} and more`))));
}

// ---- all ----

async function main() {
  showHead();
  showLost();
  showCost();
  for (const item of items) if (item !== meshItem) await load(item);
  (data.comparisons ?? [data]).forEach((c, i) => c.b_path &&
    showComparison(c, ...all('compared').slice(2 * i, 2 * i + 2), all('error')[i]));
  maps.forEach(showMap);
  missed.forEach(showMisses);
  if (!previewItem) return;
  $('missing-text').textContent = `Samples: ${count(data.misses)} of ${count(data.samples)}, ` +
    `in red. Rays reached ${number(data.front)} in front of the mesh and ${number(data.back)} behind it.`;
  if (window.THREE && el('canvas').getContext('webgl2')) return showAsset();
  $('pictures').hidden = false;
  $('pictures').prepend(Object.assign(previewItem.image, {id: 'preview', alt: 'Each row: plain, with maps, the scan'}));
  $('no3d').textContent = window.THREE ? 'This browser does not draw in 3D.' : 'For 3D, install the package libjs-three.';
}
main().then(() => document.body.dataset.ready = 'yes')
  .catch(error => { document.body.dataset.ready = 'failed'; console.error(error); });
})();
