// The 3D views. All views of a section share a camera, and all views of the page one renderer,
// whose picture is copied to the canvas of each: browsers limit the number of WebGL contexts.

const UNIT = 8 / 32767; // quantisation step of the coordinates, in view units
const BACKGROUND = 0x16181d;
const CAMERA_COLOURS = [
  0xff6b5e, 0x5ec8ff, 0xffd35e, 0x9bff8a, 0xd79bff, 0xffa14a, 0x58e0c8, 0xff8ac8,
];
const MOST_IN_LEGEND = 8;
const FIELD_OF_VIEW = 40; // degrees, vertical
const START = { yaw: 0.6, pitch: 0.6, nearest: 2.8, farthest: 8 };
// While the view moves, a slow machine draws fewer points, so that a frame takes less than this.
const SLOW_MS = 45;
const FAST_MS = 25;
const FEWEST_POINTS = 20_000;
const REST_MS = 180; // after a rest, all points are drawn
const PICK_PX = 9;

function bytes(base64) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64);
  const text = atob(base64);
  const made = new Uint8Array(text.length);
  for (let k = 0; k < made.length; k++) made[k] = text.charCodeAt(k);
  return made;
}

const POINT_VERTEX = `
  attribute vec3 shade;
  uniform float diameter, largest;
  varying vec3 colour;
  void main() {
    vec4 eye = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * eye;
    gl_PointSize = clamp(diameter / max(-eye.z, 1e-6), 1.0, largest);
    colour = shade;
  }`;
const POINT_FRAGMENT = `
  varying vec3 colour;
  void main() { gl_FragColor = vec4(colour, 1.0); }`;

// Points in one buffer, in an order whose beginnings are samples of all. Four components each,
// because graphics cards want attributes at multiples of four bytes.
function cloud({ points, colours }) {
  const [places, shades] = [new Int16Array(bytes(points).buffer), bytes(colours)];
  const count = shades.length / 3;
  const [position, shade] = [new Int16Array(4 * count), new Uint8Array(4 * count)];
  const stride = coprime(Math.round(0.618034 * count), count);
  for (let k = 0, from = 0; k < count; k++, from = (from + stride) % count)
    for (let c = 0; c < 3; c++) {
      position[4 * k + c] = places[3 * from + c];
      shade[4 * k + c] = shades[3 * from + c];
    }
  const geometry = new THREE.BufferGeometry();
  const attribute = (name, data, normalised) => {
    const buffer = new THREE.InterleavedBuffer(data, 4);
    const made = new THREE.InterleavedBufferAttribute(buffer, 3, 0, normalised);
    geometry.setAttribute(name, made);
  };
  attribute('position', position, false);
  attribute('shade', shade, true);
  geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(), 15 / UNIT);
  const uniforms = { diameter: { value: 1 }, largest: { value: 1 } };
  const material = new THREE.ShaderMaterial({
    uniforms,
    vertexShader: POINT_VERTEX,
    fragmentShader: POINT_FRAGMENT,
  });
  const made = new THREE.Points(geometry, material);
  made.scale.setScalar(UNIT);
  // Points are as large as they are far from each other, if they lie on a surface.
  return { made, count, uniforms, spacing: 1.5 / Math.sqrt(Math.max(count, 1)) };
}
function coprime(number, other) {
  const divisor = (a, b) => (b ? divisor(b, a % b) : a);
  for (let k = Math.max(number, 1); ; k++) if (divisor(k, other) === 1) return k;
}

// The eye and the four corners of the image are 15 numbers; these are the ends of the edges.
const EDGES = [0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1];
const edges = corners => EDGES.flatMap(k => Array.from(corners.subarray(3 * k, 3 * k + 3)));
function lineSegments(places, colours) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.Float32BufferAttribute(places, 3));
  geometry.setAttribute('color', new THREE.Float32BufferAttribute(colours, 3));
  const material = new THREE.LineBasicMaterial({ vertexColors: true, depthTest: false });
  const made = new THREE.LineSegments(geometry, material);
  made.frustumCulled = false;
  made.renderOrder = 1;
  return made;
}

// ---- Sections: what shares a camera ----
const sections = [];
let renderer = null;

function makeSection() {
  const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.01, 100);
  camera.up.set(0, 0, 1);
  const made = { camera, target: new THREE.Vector3(), views: [], pointSize: 1, yaw: START.yaw };
  sections.push(made);
  return made;
}
function lookFrom(section, yaw, pitch) {
  const { camera, target } = section;
  target.set(0, 0, 0);
  camera.fov = FIELD_OF_VIEW;
  const [flat, up] = [Math.cos(pitch), Math.sin(pitch)];
  const towards = new THREE.Vector3(-Math.sin(yaw) * flat, -Math.cos(yaw) * flat, up);
  camera.position.copy(towards).multiplyScalar(distanceToSeeAll(section, towards));
  camera.lookAt(target);
  redraw(section);
}
// From how far in a direction the points and nearly all cameras are in the picture.
function distanceToSeeAll({ views }, towards) {
  const [{ canvas, images }] = views;
  const slope = 0.95 * Math.tan((FIELD_OF_VIEW * Math.PI) / 360);
  const aspect = canvas.clientWidth / Math.max(canvas.clientHeight, 1) || 1;
  const right = new THREE.Vector3(0, 0, 1).cross(towards).normalize();
  const up = new THREE.Vector3().crossVectors(towards, right);
  const corner = new THREE.Vector3();
  const wanted = images.map(({ corners }) => {
    const distances = [0, 1, 2, 3, 4].map(k => {
      corner.fromArray(corners, 3 * k);
      const aside = Math.max(Math.abs(corner.dot(right)) / aspect, Math.abs(corner.dot(up)));
      return corner.dot(towards) + aside / slope;
    });
    return Math.max(...distances);
  });
  wanted.sort((a, b) => a - b);
  const most = wanted.length ? wanted[Math.ceil(0.98 * wanted.length) - 1] : 0;
  return Math.min(Math.max(START.nearest, most), START.farthest);
}
const reset = section => lookFrom(section, section.yaw, START.pitch);
const fromAbove = section => lookFrom(section, 0, Math.PI / 2 - 1e-3);
function lookThrough(section, { corners }) {
  const { camera, target } = section;
  const eye = new THREE.Vector3(...corners.subarray(0, 3));
  const corner = k => new THREE.Vector3(...corners.subarray(3 * k, 3 * k + 3)).sub(eye);
  const rays = [1, 2, 3, 4].map(corner);
  const ahead = rays.reduce((sum, ray) => sum.add(ray), new THREE.Vector3()).normalize();
  const [top, bottom] = [rays[0].add(rays[1]), rays[2].add(rays[3])];
  camera.fov = Math.min((top.angleTo(bottom) * 180) / Math.PI, 120);
  camera.position.copy(eye);
  target.copy(eye).add(ahead);
  camera.lookAt(target);
  redraw(section);
}
// The mean direction of the cameras, from which a wall shows its front; none for a round trip.
function meanYaw(images) {
  const sum = [0, 0];
  for (const { corners } of images)
    for (const k of [0, 1]) {
      const middle = (corners[3 + k] + corners[6 + k] + corners[9 + k] + corners[12 + k]) / 4;
      sum[k] += middle - corners[k];
    }
  const depth = images.reduce((total, { corners }) => {
    const middle = [0, 1, 2].map(
      k => (corners[3 + k] + corners[6 + k] + corners[9 + k] + corners[12 + k]) / 4 - corners[k],
    );
    return total + Math.hypot(...middle);
  }, 0);
  return Math.hypot(...sum) > 0.4 * depth ? Math.atan2(sum[0], sum[1]) : START.yaw;
}

// Rotates about the target by angles in radians, and scales the distance.
function turn(section, yaw, pitch, scale = 1) {
  const { camera, target } = section;
  const from = camera.position.clone().sub(target);
  const distance = from.length();
  const steepest = Math.PI / 2 - 1e-3;
  const elevation = Math.asin(from.z / distance) + pitch;
  const up = Math.min(Math.max(elevation, -steepest), steepest);
  const around = Math.atan2(from.y, from.x) + yaw;
  from.set(Math.cos(around) * Math.cos(up), Math.sin(around) * Math.cos(up), Math.sin(up));
  camera.position.copy(target).addScaledVector(from, distance * scale);
  camera.lookAt(target);
  redraw(section, true);
}
const KEYS = {
  ArrowLeft: section => turn(section, -0.1, 0),
  ArrowRight: section => turn(section, 0.1, 0),
  ArrowUp: section => turn(section, 0, 0.1),
  ArrowDown: section => turn(section, 0, -0.1),
  '+': section => turn(section, 0, 0, 0.9),
  '-': section => turn(section, 0, 0, 1 / 0.9),
  Home: section => reset(section),
};

// The colours of the cameras.
function legend(cameras) {
  const most = cameras.length > MOST_IN_LEGEND ? MOST_IN_LEGEND - 1 : MOST_IN_LEGEND;
  const line = ({ name, colour, images }) => {
    const hex = CAMERA_COLOURS[colour % CAMERA_COLOURS.length].toString(16).padStart(6, '0');
    const chip = element('span', { style: `background:#${hex}` });
    const plural = images.length === 1 ? '' : 's';
    return element('li', {}, chip, `${name}: ${images.length} image${plural}`);
  };
  const more = cameras.length - most;
  const rest = more > 0 ? [element('li', {}, `and ${more} more cameras`)] : [];
  return element('ul', { class: 'legend' }, ...cameras.slice(0, most).map(line), ...rest);
}

// The axes of the model's frame, and up. `draw` moves the ends.
const AXES = [
  ['x', '#ff6b5e'],
  ['y', '#7dff9a'],
  ['z', '#5ec8ff'],
  ['up', '#fff'],
];
function axes(directions) {
  const svg = element('svg', { class: 'axes', viewBox: '-44 -44 88 88', 'aria-hidden': true });
  const ends = AXES.map(([name, stroke], k) => {
    const dashed = name === 'up' ? { 'stroke-dasharray': '3 2' } : {};
    const line = element('line', { x1: 0, y1: 0, stroke, ...dashed });
    const text = element('text', { 'text-anchor': 'middle' }, name);
    svg.append(line, text);
    const direction = new THREE.Vector3(...(directions[k] || [0, 0, 1]));
    return { line, text, direction, isUp: name === 'up' };
  });
  return { svg, ends };
}
function drawAxes({ axes: { ends }, section: { camera } }) {
  const seen = new THREE.Vector3();
  for (const { line, text, direction, isUp } of ends) {
    seen.copy(direction).transformDirection(camera.matrixWorldInverse);
    const [x, y] = [seen.x, -seen.y];
    line.setAttribute('x2', (22 * x).toFixed(1));
    line.setAttribute('y2', (22 * y).toFixed(1));
    // Up is often an axis of the model: its name is further out, and none where it points at us.
    const [radius, least] = isUp ? [40, 0.3] : [29, 0];
    text.setAttribute('x', (radius * x).toFixed(1));
    text.setAttribute('y', (radius * y + 4).toFixed(1));
    text.style.display = Math.hypot(x, y) < least ? 'none' : '';
  }
}
// A length of 1, 2 or 5 times a power of ten at the centre of the view, up to 110 pixels.
function drawBar({ bar, canvas, unit, unitPerView, section: { camera, target } }) {
  const slope = Math.tan((camera.fov * Math.PI) / 360);
  const perView = canvas.clientHeight / (2 * slope * camera.position.distanceTo(target));
  const most = (110 * unitPerView) / perView;
  const power = 10 ** Math.floor(Math.log10(most));
  const length = power * [5, 2, 1].find(digit => digit * power <= most * (1 + 1e-9));
  bar.firstChild.style.width = `${(length / unitPerView) * perView}px`;
  bar.lastChild.textContent = `${short(length)} ${length === 1 ? unit.replace(/s$/, '') : unit}`;
}

// A view of a model's points and cameras. `onPick(image)` is called for a clicked camera.
function makeView(section, model, photos, onPick) {
  const canvas = element('canvas', {
    tabindex: 0,
    role: 'application',
    'aria-label':
      `3D view of ${model.name}. Arrow keys rotate, plus and minus zoom, Home shows all;` +
      ' the list above has the photos.',
  });
  const label = element('div', { class: 'label' });
  const bar = element('div', { class: 'bar' }, element('div'), element('span'));
  const gizmo = axes(model.axes);
  const parts = [canvas, legend(model.cameras), gizmo.svg, bar, label];
  const place = element('div', { class: 'scene' }, ...parts);
  const scene = new THREE.Scene();
  const images = model.cameras.flatMap(({ colour, corners, images }) =>
    images.map((image, k) => ({
      ...image,
      colour: CAMERA_COLOURS[colour % CAMERA_COLOURS.length],
      corners: new Float32Array(corners.slice(15 * k, 15 * k + 15)),
    })),
  );
  const points = cloud(model);
  scene.add(points.made);
  const paint = new THREE.Color();
  const colours = images.flatMap(({ colour }) => {
    const { r, g, b } = paint.setHex(colour);
    return EDGES.flatMap(() => [r, g, b]);
  });
  const frusta = lineSegments(
    images.flatMap(({ corners }) => edges(corners)),
    colours,
  );
  const picked = lineSegments(
    EDGES.flatMap(() => [0, 0, 0]),
    EDGES.flatMap(() => [1, 1, 1]),
  );
  picked.visible = false;
  picked.renderOrder = 2;
  scene.add(frusta, picked);
  if (model.trajectory) {
    const geometry = new THREE.BufferGeometry();
    const { truth } = model.trajectory;
    geometry.setAttribute('position', new THREE.Float32BufferAttribute(truth, 3));
    const material = new THREE.LineBasicMaterial({ color: 0x7dff9a, depthTest: false });
    const line = new THREE.Line(geometry, material);
    line.frustumCulled = false;
    scene.add(line);
  }
  const context = canvas.getContext('2d', { alpha: false });
  const view = { section, canvas, context, scene, images, photos, points, frusta, picked };
  Object.assign(view, { isSeen: true, drawn: 0, bar, axes: gizmo });
  Object.assign(view, { unit: model.unit, unitPerView: model.unit_per_view });
  section.views.push(view);
  if (section.views.length === 1) section.yaw = meanYaw(images);

  const controls = new THREE.OrbitControls(section.camera, canvas);
  controls.target = section.target;
  controls.zoomToCursor = true;
  controls.maxDistance = 60;
  controls.addEventListener('change', () => redraw(section, true));
  let pressed = null;
  canvas.addEventListener('pointerdown', event => {
    pressed = [event.clientX, event.clientY];
  });
  canvas.addEventListener('click', event => {
    const [x, y] = pressed || [event.clientX, event.clientY];
    pressed = null;
    if (Math.hypot(event.clientX - x, event.clientY - y) > 4) return;
    const image = imageAt(view, event);
    if (image) onPick(image);
  });
  canvas.addEventListener('pointermove', event => {
    const image = event.buttons ? null : imageAt(view, event);
    canvas.style.cursor = image ? 'pointer' : '';
    label.textContent = image ? image.name : '';
  });
  canvas.addEventListener('dblclick', () => fromAbove(section));
  canvas.addEventListener('keydown', event => {
    const act = KEYS[event.key === '=' ? '+' : event.key];
    if (!act) return;
    event.preventDefault();
    act(section);
  });
  new ResizeObserver(() => redraw(section)).observe(place);
  new IntersectionObserver(([entry]) => {
    view.isSeen = entry.isIntersecting;
    redraw(section);
  }).observe(place);
  return { place, view };
}

// ---- Cameras under the pointer ----
const scratch = { corner: null };
// Position in pixels of a corner of a frustum on the canvas; null behind the viewer.
function onCanvas({ canvas, section: { camera } }, corners, k) {
  scratch.corner = scratch.corner || new THREE.Vector3();
  const corner = scratch.corner.fromArray(corners, 3 * k).applyMatrix4(camera.matrixWorldInverse);
  if (corner.z > -camera.near) return null;
  corner.applyMatrix4(camera.projectionMatrix);
  const { clientWidth, clientHeight } = canvas;
  return [((corner.x + 1) / 2) * clientWidth, ((1 - corner.y) / 2) * clientHeight];
}
function distanceToEdge([x, y], [x1, y1], [x2, y2]) {
  const [dx, dy] = [x2 - x1, y2 - y1];
  const along = ((x - x1) * dx + (y - y1) * dy) / (dx * dx + dy * dy || 1);
  const share = Math.min(Math.max(along, 0), 1);
  return Math.hypot(x - x1 - share * dx, y - y1 - share * dy);
}
function prepare({ canvas, section: { camera } }) {
  camera.aspect = canvas.clientWidth / Math.max(canvas.clientHeight, 1);
  const distance = camera.position.length();
  camera.near = Math.max(0.002, 0.002 * distance);
  camera.far = distance + 40;
  camera.updateProjectionMatrix();
  camera.updateMatrixWorld();
}
// The image whose frustum's edges are nearest to the pointer; null if none is near.
function imageAt(view, event) {
  if (!view.frusta.visible) return null;
  prepare(view);
  const box = view.canvas.getBoundingClientRect();
  const pointer = [event.clientX - box.left, event.clientY - box.top];
  let [nearest, found] = [PICK_PX, null];
  for (const image of view.images) {
    const corners = [0, 1, 2, 3, 4].map(k => onCanvas(view, image.corners, k));
    if (corners.includes(null)) continue;
    for (let k = 0; k < EDGES.length; k += 2) {
      const distance = distanceToEdge(pointer, corners[EDGES[k]], corners[EDGES[k + 1]]);
      if (distance < nearest) [nearest, found] = [distance, image];
    }
  }
  return found;
}
// Marks an image in all views of a section; null removes the mark.
function mark(section, name) {
  for (const { images, picked } of section.views) {
    const image = images.find(one => one.name === name);
    picked.visible = image !== undefined;
    if (!image) continue;
    picked.geometry.attributes.position.set(edges(image.corners));
    picked.geometry.attributes.position.needsUpdate = true;
  }
  redraw(section);
}

// ---- Drawing, on demand ----
const motion = { limit: Infinity, last: 0, until: 0, isAsked: false, isPending: false };

// `isMoving`: more frames will follow soon.
function redraw(section, isMoving = false) {
  section.isStale = true;
  if (isMoving) Object.assign(motion, { isAsked: true, until: performance.now() + REST_MS });
  request();
}
function request() {
  if (motion.isPending) return;
  motion.isPending = true;
  requestAnimationFrame(frameAt);
}
function frameAt(now) {
  motion.isPending = false;
  // A slow frame may take longer than a rest.
  const isMoving = motion.isAsked || performance.now() < motion.until;
  motion.isAsked = false;
  if (motion.last) adapt(now - motion.last);
  motion.last = isMoving ? now : 0;
  for (const section of sections) {
    // What moved with fewer points is drawn again with all.
    const isComplete = section.views.every(view => !view.isSeen || view.drawn >= view.points.count);
    if (!section.isStale && (isMoving || isComplete)) continue;
    section.isStale = false;
    for (const view of section.views) if (view.isSeen) draw(view, isMoving);
  }
  // Frames in a row tell how long one takes.
  if (isMoving) request();
}
// Changes the number of points drawn in motion by the time of the last frame.
function adapt(took) {
  const shown = sections.flatMap(({ views }) => views).filter(view => view.isSeen);
  const most = shown.reduce((sum, { points }) => Math.max(sum, points.count), 0);
  const limit = Math.min(motion.limit, most);
  if (took > SLOW_MS) motion.limit = Math.max(FEWEST_POINTS, limit * Math.max(0.1, SLOW_MS / took));
  else if (took < FAST_MS) motion.limit = limit < most ? limit * 1.25 : Infinity;
}
function draw(view, isMoving) {
  const { canvas, context, scene, section, points } = view;
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.round(canvas.clientWidth * ratio);
  const height = Math.round(canvas.clientHeight * ratio);
  if (!width || !height) return;
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  const shared = renderer.domElement;
  if (shared.width < width || shared.height < height)
    renderer.setSize(Math.max(shared.width, width), Math.max(shared.height, height), false);
  prepare(view);
  const pixels = height / (2 * Math.tan((section.camera.fov * Math.PI) / 360));
  points.uniforms.diameter.value = points.spacing * section.pointSize * pixels;
  points.uniforms.largest.value = Math.max(1, 4 * ratio * section.pointSize);
  view.drawn = isMoving ? Math.min(points.count, Math.round(motion.limit)) : points.count;
  points.made.geometry.setDrawRange(0, view.drawn);
  renderer.setViewport(0, 0, width, height);
  renderer.setScissor(0, 0, width, height);
  renderer.render(scene, section.camera);
  context.drawImage(shared, 0, shared.height - height, width, height, 0, 0, width, height);
  document.documentElement.dataset.points = view.drawn;
  drawAxes(view);
  drawBar(view);
}
// Whether the browser has WebGL.
function startRenderer() {
  try {
    renderer = new THREE.WebGLRenderer({ antialias: false, powerPreference: 'high-performance' });
  } catch {
    return false;
  }
  renderer.setPixelRatio(1);
  renderer.setScissorTest(true);
  renderer.setClearColor(BACKGROUND, 1);
  return true;
}
