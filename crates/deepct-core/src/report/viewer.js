'use strict';
// The interactive view of volumes: ray marching through a 3D texture (WebGL2), and slices as maps.
// Lengths are in km; x is east, y north, z up. Arrays are [z, y, x].

(() => {
const byId = id => document.getElementById(id);
const data = JSON.parse(byId('data').textContent);
const FIELD_OF_VIEW = 0.5;       // radians
const STILL_MS = 160;            // without motion, after which the view is drawn in full
const FRAME_MS = 1000 / 30;      // aim while the view turns
const LEAST_QUALITY = 0.2;       // pixels of the coarsest view by those of the full one, along each side
const FOG_DEPTH = 80;            // optical depth of the coloured medium along the diagonal

// ---------------------------------------------------------------------------------- vectors
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b, factor = 1) => a.map((value, axis) => value + factor * b[axis]);
const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** Unit vector towards a zenith angle and an azimuth clockwise from north (radians). */
const towards = (zenith, azimuth) =>
  [Math.sin(zenith) * Math.sin(azimuth), Math.sin(zenith) * Math.cos(azimuth), Math.cos(zenith)];
const radians = degrees => degrees * Math.PI / 180;

// ---------------------------------------------------------------------------------- data
/** Decompress the values of a stored field: 8-bit or 16-bit integers in the format of zlib, times a step. */
async function decode(field) {
  if (field.decoded) return;
  const bytes = Uint8Array.from(atob(field.values), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  const buffer = await new Response(stream).arrayBuffer();
  const integers = field.bits === 16 ? new DataView(buffer) : new Uint8Array(buffer);
  const count = buffer.byteLength / (field.bits / 8);
  field.decoded = Float32Array.from({ length: count }, (_, index) =>
    field.step * (field.bits === 16 ? integers.getUint16(2 * index, true) : integers[index]));
}

/** The volumes of a pair: the truth, if it is known, and the estimate. */
const volumesOf = pair =>
  [pair.truth, pair.estimate].filter(index => index !== null).map(index => data.volumes[index]);

function largest(values) {
  let found = 0;
  for (const value of values) found = Math.max(found, Math.abs(value));
  return found;
}

/** The end of a colour scale: the 99.8th percentile of the sizes of the values that are not zero, so that single
    bright ones do not darken all others. */
function robustLimit(arrays) {
  const sizes = arrays.map(values => values.filter(value => value !== 0).map(Math.abs));
  const all = new Float32Array(sizes.reduce((sum, one) => sum + one.length, 0));
  sizes.reduce((start, one) => (all.set(one, start), start + one.length), 0);
  return all.length ? all.sort()[Math.ceil(0.998 * (all.length - 1))] : 0;
}

/** What is shown of a pair, whose fields are decoded, for each choice of the field: a panel for the truth
    and the estimate. */
function choicesOf(pair) {
  const volumes = volumesOf(pair);
  const estimate = volumes[volumes.length - 1], truth = volumes.length > 1 && volumes[0];
  const panel = (volume, name, values, palette, high, unit, low = 0) => {
    const most = largest(values);
    const label = most > high ? `${unit}, largest ${Number(most.toPrecision(3))}` : unit;
    return { volume, name, values, palette, low, high: high || 1, unit, label, sunlit: false };
  };
  const unit = 'km\u207b\u00b9';
  const choices = [];
  if (estimate.fields.extinction) {
    const values = volumes.map(volume => volume.fields.extinction.decoded);
    const high = robustLimit(values);
    const panels = volumes.map((volume, number) =>
      panel(volume, `${volume.name}: extinction`, values[number], 'extinction', high, unit));
    choices.push({ name: 'cloud in sunlight', panels: panels.map(one => ({ ...one, sunlit: true })) });
    choices.push({ name: 'extinction', panels });
    const error = truth && values[1].map((value, index) => value - values[0][index]);
    if (truth) {
      const most = robustLimit([error]);
      choices.push({ name: 'difference', panels: [panels[0],
        panel(estimate, `${estimate.name}: estimate \u2212 truth`, error, 'difference', most, unit, -most)] });
    }
    if (estimate.fields.uncertainty) {
      const expected = estimate.fields.uncertainty.decoded;
      const found = truth && error.map(Math.abs);
      const most = robustLimit(found ? [expected, found] : [expected]);
      const right = panel(estimate, `${estimate.name}: expected absolute error`, expected,
        'uncertainty', most, unit);
      const left = truth && panel(estimate, 'absolute error', found, 'uncertainty', most, unit);
      choices.push({ name: 'uncertainty', panels: left ? [left, right] : [right] });
    }
  }
  if (estimate.fields.mask) {
    const mask = panel(estimate, `${estimate.name}: mask`, estimate.fields.mask.decoded, 'mask', 1, '');
    const left = truth && panel(truth, `${truth.name}: extinction`,
      truth.fields.extinction.decoded, 'extinction', robustLimit([truth.fields.extinction.decoded]), unit);
    choices.push({ name: 'mask', panels: left ? [left, mask] : [mask] });
  }
  return choices;
}

/** Corners, voxels (km) and numbers of voxels of a volume, along x, y, z. */
function gridOf(volume) {
  const n = [...volume.shape].reverse();
  const size = n.map((count, axis) => count * volume.spacing[axis]);
  return { n, low: volume.origin, size, voxel: volume.spacing, steps: [1, n[0], n[0] * n[1]] };
}

const paletteOf = name => {
  const hex = data.palettes[name];
  return Array.from({ length: hex.length / 6 }, (_, index) =>
    [0, 2, 4].map(at => parseInt(hex.substr(6 * index + at, 2), 16)));
};
const palettes = Object.fromEntries(Object.keys(data.palettes).map(name => [name, paletteOf(name)]));

function colourOf(panel, value) {
  const colours = palettes[panel.palette];
  const share = (value - panel.low) / (panel.high - panel.low);
  return colours[Math.round(Math.min(Math.max(share, 0), 1) * (colours.length - 1))];
}

// ---------------------------------------------------------------------------------- sunlight
/** Optical depth from the centre of each voxel towards a direction. Layer by layer along the axis
    along which the direction advances most; within a layer, the values are interpolated. */
function opticalDepth(extinction, grid, direction) {
  const rate = direction.map((value, axis) => value / grid.voxel[axis]);
  const main = [0, 1, 2].reduce((best, axis) => Math.abs(rate[axis]) > Math.abs(rate[best]) ? axis : best);
  const [b, c] = [0, 1, 2].filter(axis => axis !== main);
  const path = 1 / Math.abs(rate[main]);
  const [shiftB, shiftC] = [rate[b] * path, rate[c] * path];
  const [nb, nc] = [grid.n[b], grid.n[c]];
  const depth = new Float32Array(extinction.length);
  let before = new Float32Array(nb * nc), after = new Float32Array(nb * nc);
  const at = (i, j) => i < 0 || j < 0 || i >= nb || j >= nc ? 0 : before[j * nb + i];
  const [floorB, floorC] = [Math.floor(shiftB), Math.floor(shiftC)];
  const [partB, partC] = [shiftB - floorB, shiftC - floorC];
  for (let layer = 0; layer < grid.n[main]; layer++) {
    const start = (rate[main] > 0 ? grid.n[main] - 1 - layer : layer) * grid.steps[main];
    for (let j = 0; j < nc; j++) {
      for (let i = 0; i < nb; i++) {
        const [x, y] = [i + floorB, j + floorC];
        const above = (1 - partC) * ((1 - partB) * at(x, y) + partB * at(x + 1, y))
          + partC * ((1 - partB) * at(x, y + 1) + partB * at(x + 1, y + 1));
        const voxel = start + i * grid.steps[b] + j * grid.steps[c];
        depth[voxel] = above + 0.5 * extinction[voxel] * path;
        after[j * nb + i] = above + extinction[voxel] * path;
      }
    }
    [before, after] = [after, before];
  }
  return depth;
}

/** Distance to the next filled voxel, in voxels along the axis in which it is largest: two sweeps. */
function distances(filled, grid) {
  const [nx, ny, nz] = grid.n;
  const found = new Uint8Array(filled.length);
  for (let voxel = 0; voxel < filled.length; voxel++) found[voxel] = filled[voxel] ? 0 : 255;
  const offsets = [];
  for (const z of [-1, 0]) for (const y of [-1, 0, 1]) for (const x of [-1, 0, 1])
    if (z < 0 || y < 0 || (y === 0 && x < 0)) offsets.push([x, y, z]);
  for (const sign of [1, -1]) {
    for (let number = 0; number < found.length; number++) {
      const voxel = sign > 0 ? number : found.length - 1 - number;
      if (found[voxel] === 0) continue;
      const [x, y, z] = [voxel % nx, Math.floor(voxel / nx) % ny, Math.floor(voxel / (nx * ny))];
      let least = found[voxel];
      for (const [dx, dy, dz] of offsets) {
        const [i, j, k] = [x + sign * dx, y + sign * dy, z + sign * dz];
        if (i < 0 || j < 0 || k < 0 || i >= nx || j >= ny || k >= nz) continue;
        least = Math.min(least, found[(k * ny + j) * nx + i] + 1);
      }
      found[voxel] = least;
    }
  }
  return found;
}

/** The texture of a panel. Red: opacity; green: sunlight or colour; blue: distance to the next filled
    voxel; alpha: skylight. Values up to the threshold are transparent. */
function textureOf(panel, threshold, sun) {
  const grid = gridOf(panel.volume);
  const shown = panel.values.map(value => Math.abs(value) > threshold ? Math.abs(value) : 0);
  const most = largest(shown) || 1;
  const opacity = Uint8Array.from(shown, value => Math.round(255 * value / most));
  const distance = distances(opacity, grid);
  const bytes = new Uint8Array(4 * shown.length);
  const sunlight = panel.sunlit && opticalDepth(shown, grid, sun);
  const skylight = panel.sunlit && opticalDepth(shown, grid, [0, 0, 1]);
  for (let voxel = 0; voxel < shown.length; voxel++) {
    bytes[4 * voxel] = opacity[voxel];
    bytes[4 * voxel + 2] = distance[voxel];
    if (panel.sunlit) {
      // Direct light fades exponentially, and light that was scattered many times as the inverse of the depth.
      const depth = sunlight[voxel];
      bytes[4 * voxel + 1] = 255 * (0.4 * Math.exp(-0.5 * depth) + 0.6 / (1 + 0.12 * depth));
      bytes[4 * voxel + 3] = 255 / (1 + 0.15 * skylight[voxel]);
    } else {
      const share = (panel.values[voxel] - panel.low) / (panel.high - panel.low);
      bytes[4 * voxel + 1] = Math.round(255 * Math.min(Math.max(share, 0), 1));
    }
  }
  return { bytes, grid, most };
}

// ---------------------------------------------------------------------------------- ray marching
const VERTEX = `#version 300 es
in vec2 corner;
out vec2 screen;
void main() { screen = corner; gl_Position = vec4(corner, 0.0, 1.0); }`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler3D;
uniform sampler3D field;         // opacity, sunlight or colour, distance to the next filled voxel, skylight
uniform sampler2D palette;
uniform vec3 eye, right, up, forward, low, size, voxel;
uniform vec4 cut;                // normal and position of the plane of the cut; no cut if the normal is 0
uniform float density;           // extinction (km-1) of full opacity
uniform float share;             // place of full opacity on the colour scale, in sunlight
uniform float pace;              // step of a ray in voxels
uniform bool sunlit;
in vec2 screen;
out vec4 colour;

vec4 at(vec3 point) { return texture(field, (point - low) / size); }
vec3 palette_at(float place) { return texture(palette, vec2(place, 0.5)).rgb; }

void main() {
  colour = vec4(0.0);
  vec3 ray = normalize(forward + screen.x * right + screen.y * up);
  vec3 one = (low - eye) / ray, other = (low + size - eye) / ray;
  vec3 entry = min(one, other), leave = max(one, other);
  float t = max(max(entry.x, entry.y), max(entry.z, 0.0));
  float end = min(leave.x, min(leave.y, leave.z));
  if (t >= end) return;
  float clear = 1.0;
  if (dot(cut.xyz, cut.xyz) > 0.0) {
    // The half of the box that contains the eye is taken away.
    float side = dot(cut.xyz, eye) - cut.w;
    float plane = -side / dot(cut.xyz, ray);
    if (plane > t && plane < end) {
      t = plane;
      vec4 here = at(eye + t * ray);
      bool filled = here.r > 0.004;
      float opacity = filled ? 1.0 : 0.12;
      vec3 shade = filled ? palette_at(sunlit ? here.r * share : here.g) : vec3(0.3);
      colour = vec4(opacity * shade, opacity);
      clear -= opacity;
    } else if (side * (dot(cut.xyz, eye + 0.5 * (t + end) * ray) - cut.w) > 0.0) return;
  }
  float small = min(voxel.x, min(voxel.y, voxel.z));
  float path = pace * small;
  // A random start of each ray prevents rings.
  t += path * fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
  for (int count = 0; count < 2048 && t < end && clear > 0.01; count++) {
    vec4 here = at(eye + t * ray);
    // Interpolated distances are too large by up to one voxel, and a voxel reaches one voxel far.
    float gap = (255.0 * here.b - 2.0) * small;
    if (gap > path) { t += gap; continue; }
    if (here.r > 0.0) {
      float opacity = clear * (1.0 - exp(-density * here.r * path));
      vec3 light = sunlit
        ? vec3(1.0, 0.965, 0.91) * here.g + vec3(0.16, 0.21, 0.29) * here.a
        : palette_at(here.g);
      colour += vec4(opacity * light, opacity);
      clear -= opacity;
    }
    t += path;
  }
  if (sunlit && ray.z < 0.0 && end == leave.z && clear > 0.01) {
    vec3 light = vec3(0.17, 0.27, 0.36) * (0.25 + 0.75 * at(eye + end * ray).g);
    colour += 0.75 * clear * vec4(light, 1.0);
  }
  colour = min(colour, vec4(1.0));
}`;

/** The program of the graphics processor; null without WebGL2. */
function createMarcher() {
  const canvas = document.createElement('canvas');
  const gl = canvas.getContext('webgl2', { alpha: true, premultipliedAlpha: true, antialias: false });
  if (!gl) return null;
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) console.error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return null;
  gl.useProgram(program);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
  const corner = gl.getAttribLocation(program, 'corner');
  gl.enableVertexAttribArray(corner);
  gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
  const place = Object.fromEntries(
    ['field', 'palette', 'eye', 'right', 'up', 'forward', 'low', 'size', 'voxel', 'cut', 'density',
      'share', 'pace', 'sunlit'].map(name => [name, gl.getUniformLocation(program, name)]));
  gl.uniform1i(place.field, 0);
  gl.uniform1i(place.palette, 1);

  const texture = (target, unit) => {
    const made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, made);
    for (const name of ['TEXTURE_WRAP_S', 'TEXTURE_WRAP_T', 'TEXTURE_WRAP_R'])
      gl.texParameteri(target, gl[name], gl.CLAMP_TO_EDGE);
    for (const name of ['TEXTURE_MIN_FILTER', 'TEXTURE_MAG_FILTER'])
      gl.texParameteri(target, gl[name], gl.LINEAR);
    return made;
  };
  return {
    canvas,
    /** Send a panel to the graphics processor. */
    load(panel, threshold, sun) {
      const { bytes, grid, most } = textureOf(panel, threshold, sun);
      const field = texture(gl.TEXTURE_3D, 0);
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA8, ...grid.n, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
      const colours = palettes[panel.palette];
      const palette = texture(gl.TEXTURE_2D, 1);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, colours.length, 1, 0, gl.RGB, gl.UNSIGNED_BYTE,
        new Uint8Array(colours.flat()));
      const fog = FOG_DEPTH / Math.hypot(...grid.size);
      return { grid, field, palette, sunlit: panel.sunlit, density: panel.sunlit ? most : fog,
        share: most / panel.high };
    },
    free(loaded) {
      gl.deleteTexture(loaded.field);
      gl.deleteTexture(loaded.palette);
    },
    /** Draw a view of `width` x `height` pixels. */
    draw(loaded, camera, cut, width, height, pace) {
      if (canvas.width !== width || canvas.height !== height)
        [canvas.width, canvas.height] = [width, height];
      gl.viewport(0, 0, width, height);
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_3D, loaded.field);
      gl.activeTexture(gl.TEXTURE1);
      gl.bindTexture(gl.TEXTURE_2D, loaded.palette);
      const half = Math.tan(0.5 * FIELD_OF_VIEW);
      const scaled = (vector, factor) => vector.map(value => value * factor);
      gl.uniform3fv(place.eye, camera.eye);
      gl.uniform3fv(place.right, scaled(camera.right, half * width / height));
      gl.uniform3fv(place.up, scaled(camera.up, half));
      gl.uniform3fv(place.forward, camera.forward);
      gl.uniform3fv(place.low, loaded.grid.low);
      gl.uniform3fv(place.size, loaded.grid.size);
      gl.uniform3fv(place.voxel, loaded.grid.voxel);
      gl.uniform4fv(place.cut, cut);
      gl.uniform1f(place.density, loaded.density);
      gl.uniform1f(place.share, loaded.share);
      gl.uniform1f(place.pace, pace);
      gl.uniform1i(place.sunlit, loaded.sunlit);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    },
  };
}

// ---------------------------------------------------------------------------------- axes
/** Round numbers in a range, with their text. */
function ticks(low, high, most) {
  const rough = (high - low) / Math.max(most, 2);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(factor => factor * power).find(one => one >= rough * (1 - 1e-9));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let number = Math.ceil(low / step - 1e-6); number * step <= high + 1e-6 * step; number++)
    found.push({ value: number * step, text: (number * step || 0).toFixed(decimals) });
  return found;
}

function line(context, from, to) {
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
}

function arrow(context, from, to) {
  line(context, from, to);
  const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
  for (const turn of [2.6, -2.6])
    line(context, to, [to[0] + 8 * Math.cos(angle + turn), to[1] + 8 * Math.sin(angle + turn)]);
}

/** The camera that looks at a point from a direction. */
function cameraOf(state, target) {
  const back = towards(Math.PI / 2 - state.elevation, state.azimuth);
  const right = [-Math.cos(state.azimuth), Math.sin(state.azimuth), 0];
  const eye = add(target, back, state.distance);
  return { eye, right, up: cross(back, right), forward: back.map(value => -value) };
}

/** The function that projects points to pixels. */
function projection(camera, width, height) {
  const focal = 0.5 * height / Math.tan(0.5 * FIELD_OF_VIEW);
  return point => {
    const offset = add(point, camera.eye, -1);
    const depth = Math.max(dot(offset, camera.forward), 1e-6);
    return [width / 2 + focal * dot(offset, camera.right) / depth,
      height / 2 - focal * dot(offset, camera.up) / depth];
  };
}

/** The far edges of the box, and its axes in km. */
function drawBox(context, grid, camera, project) {
  const corner = bits => grid.low.map((value, axis) => value + (bits >> axis & 1) * grid.size[axis]);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7];
  const depth = bits => dot(add(corner(bits), camera.eye, -1), camera.forward);
  const nearest = corners.reduce((best, bits) => depth(bits) < depth(best) ? bits : best);
  for (const from of corners) for (const bit of [1, 2, 4]) {
    if (from & bit || from === nearest || (from | bit) === nearest) continue;
    line(context, project(corner(from)), project(corner(from | bit)));
  }
  const middle = project(add(grid.low, grid.size, 0.5));
  const floor = nearest & 3;
  // x and y along the floor edges nearest to the viewer, z at a vertical edge at the side.
  const sides = [floor ^ 1, floor ^ 2];
  const side = project(corner(sides[0]))[0] < project(corner(sides[1]))[0] ? sides[0] : sides[1];
  const starts = [floor & 2, floor & 1, side];
  starts.forEach((start, axis) => {
    const ends = [corner(start), corner(start | 1 << axis)];
    const length = Math.hypot(...add(project(ends[0]), project(ends[1]), -1).slice(0, 2));
    if (length < 40) return;
    const outwards = point => {
      const away = axis === 2 ? [-1, 0] : [point[0] - middle[0], Math.abs(point[1] - middle[1]) + 60];
      const norm = Math.hypot(...away);
      return [point[0] + 16 * away[0] / norm, point[1] + 12 * away[1] / norm];
    };
    context.textAlign = axis === 2 ? 'right' : 'center';
    for (const { value, text } of ticks(grid.low[axis], grid.low[axis] + grid.size[axis], length / 55)) {
      const point = corner(start);
      point[axis] = value;
      const at = project(point), out = outwards(at);
      line(context, at, [at[0] + 0.4 * (out[0] - at[0]), at[1] + 0.4 * (out[1] - at[1])]);
      context.fillText(text, out[0], out[1] + 4);
    }
    const at = project(add(ends[0], ends[1]).map(value => 0.5 * value)), out = outwards(at);
    if (axis !== 2) context.textAlign = out[0] < at[0] ? 'right' : 'left';
    // The label of the altitude stays inside the view.
    const place = at[0] + (axis === 2 ? 2.2 : 2.6) * (out[0] - at[0]);
    const least = axis === 2 ? context.measureText(AXES[axis]).width + 4 : 0;
    context.fillText(AXES[axis], Math.max(place, least), at[1] + 3.2 * (out[1] - at[1]) + 4);
  });
}

/** Arrows to the north, upwards and to the Sun, in a corner. */
function drawDirections(context, camera, sun) {
  const from = [62, 66];
  const shown = vector => {
    const [x, y] = [dot(vector, camera.right), -dot(vector, camera.up)];
    return [from[0] + 38 * x, from[1] + 38 * y];
  };
  context.fillStyle = 'rgba(255, 255, 255, 0.7)';
  context.beginPath();
  context.arc(...from, 56, 0, 2 * Math.PI);
  context.fill();
  context.lineWidth = 2;
  context.textAlign = 'center';
  for (const [vector, name, colour] of [[[0, 1, 0], 'N', '#c0392b'], [[0, 0, 1], 'up', '#333'], [sun, 'Sun', '#d98200']]) {
    context.strokeStyle = context.fillStyle = colour;
    const to = shown(vector);
    arrow(context, from, to);
    context.fillText(name, to[0] + 0.28 * (to[0] - from[0]), to[1] + 0.28 * (to[1] - from[1]) + 4);
  }
}

// ---------------------------------------------------------------------------------- slices
const SECTIONS = { z: [2, 0, 1], y: [1, 0, 2], x: [0, 1, 2] };  // normal, to the right, upwards
const AXES = ['x, east (km)', 'y, north (km)', 'altitude (km)'];

/** Draw a slice as a map with its axes and colour bar; returns the function that reads its values. */
function drawSlice(canvas, panel, axis, index) {
  const grid = gridOf(panel.volume);
  const [normal, right, up] = SECTIONS[axis];
  const [columns, rows] = [grid.n[right], grid.n[up]];
  const value = (column, row) =>
    panel.values[index * grid.steps[normal] + column * grid.steps[right] + row * grid.steps[up]];
  const picture = document.createElement('canvas');
  [picture.width, picture.height] = [columns, rows];
  const pixels = new ImageData(columns, rows);
  for (let row = 0; row < rows; row++) for (let column = 0; column < columns; column++)
    pixels.data.set([...colourOf(panel, value(column, row)), 255], 4 * ((rows - 1 - row) * columns + column));
  picture.getContext('2d').putImageData(pixels, 0, 0);

  const [least, top, bar, below] = [58, 30, 96, 44];
  const wide = canvas.clientWidth - least - bar;
  const scale = Math.min(wide / grid.size[right], 300 / grid.size[up]);
  const [width, height] = [Math.round(scale * grid.size[right]), Math.max(Math.round(scale * grid.size[up]), 30)];
  const left = least + Math.floor(0.5 * (wide - width));
  const context = fit(canvas, canvas.clientWidth, height + top + below);
  context.imageSmoothingEnabled = false;
  context.drawImage(picture, left, top, width, height);
  context.strokeStyle = context.fillStyle = '#222';
  context.strokeRect(left - 0.5, top - 0.5, width + 1, height + 1);
  context.textAlign = 'center';
  const centre = grid.low[normal] + (index + 0.5) * grid.voxel[normal];
  context.fillText(`${panel.name}, ${axis} = ${centre.toFixed(3)} km`, left + width / 2, 18);
  for (const { value, text } of ticks(grid.low[right], grid.low[right] + grid.size[right], width / 60)) {
    const x = left + scale * (value - grid.low[right]);
    line(context, [x, top + height], [x, top + height + 5]);
    context.fillText(text, x, top + height + 18);
  }
  context.fillText(AXES[right], left + width / 2, top + height + 36);
  context.textAlign = 'right';
  for (const { value, text } of ticks(grid.low[up], grid.low[up] + grid.size[up], height / 32)) {
    const y = top + height - (value - grid.low[up]) / grid.size[up] * height;
    line(context, [left - 5, y], [left, y]);
    context.fillText(text, left - 8, y + 4);
  }
  upwards(context, AXES[up], left - 42, top + height / 2);
  const x = left + width + 14;
  for (let y = 0; y < height; y++) {
    const place = panel.low + (1 - (y + 0.5) / height) * (panel.high - panel.low);
    context.fillStyle = `rgb(${colourOf(panel, place)})`;
    context.fillRect(x, top + y, 14, 1.5);
  }
  context.fillStyle = '#222';
  context.strokeRect(x - 0.5, top - 0.5, 15, height + 1);
  context.textAlign = 'left';
  for (const { value, text } of ticks(panel.low, panel.high, height / 40)) {
    const y = top + height - (value - panel.low) / (panel.high - panel.low) * height;
    line(context, [x + 14, y], [x + 19, y]);
    context.fillText(text, x + 22, y + 4);
  }
  if (panel.label) upwards(context, panel.label, x + 66, top + height / 2);

  return (x, y) => {
    const column = Math.floor((x - left) / width * columns);
    const row = Math.floor((1 - (y - top) / height) * rows);
    if (column < 0 || row < 0 || column >= columns || row >= rows) return '';
    const at = { [normal]: index, [right]: column, [up]: row };
    const place = ['x', 'y', 'z'].map((name, axis) =>
      `${name} ${(grid.low[axis] + (at[axis] + 0.5) * grid.voxel[axis]).toFixed(3)}`);
    return `${place.join(', ')} km: ${value(column, row).toPrecision(4)} ${panel.unit}`;
  };
}

function upwards(context, text, x, y) {
  context.save();
  context.translate(x, y);
  context.rotate(-Math.PI / 2);
  context.textAlign = 'center';
  context.fillText(text, 0, 0);
  context.restore();
}

/** A canvas of a size in CSS pixels, cleared, with a share of the pixels of the screen along each side;
    returns its context, which draws in CSS pixels. */
function fit(canvas, width, height, share = 1) {
  const ratio = share * (window.devicePixelRatio || 1);
  canvas.style.height = `${height}px`;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  // Kept in the main memory: without a graphics processor, this is the faster way.
  const context = canvas.getContext('2d', { willReadFrequently: true });
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = '12px sans-serif';
  context.lineWidth = 1;
  return context;
}

// ---------------------------------------------------------------------------------- the page
const marcher = createMarcher();
const controls = Object.fromEntries(
  ['pair', 'field', 'threshold', 'axis', 'position', 'cut', 'reset'].map(name => [name, byId(name)]));
const state = { azimuth: 0, elevation: 0, distance: 1, quality: 0.5, movedAt: -Infinity, full: false };
let pair, choices, choice, shown = [], pending = false, frameAt = 0;

function fill(select, names) {
  select.replaceChildren(...names.map((name, value) => new Option(name, value)));
}

async function choosePair() {
  const chosen = data.pairs[controls.pair.value];
  await Promise.all(volumesOf(chosen).flatMap(volume => Object.values(volume.fields)).map(decode));
  // Another pair may have been chosen in the meantime.
  if (chosen !== data.pairs[controls.pair.value]) return;
  pair = chosen;
  choices = choicesOf(pair);
  const before = choice && choice.name;
  fill(controls.field, choices.map(one => one.name));
  controls.field.value = Math.max(0, choices.findIndex(one => one.name === before));
  byId('sun').textContent = `Sun at zenith angle ${pair.sun.zenith.toFixed(1)}°, azimuth `
    + `${pair.sun.azimuth.toFixed(0)}° from north (${pair.sun.source}).`;
  chooseField();
  reset();
}

function chooseField() {
  choice = choices[controls.field.value];
  const most = Math.max(...choice.panels.map(panel => largest(panel.values)));
  Object.assign(controls.threshold, { min: 0, max: most, step: most / 200, value: 0 });
  const stage = byId('stage');
  stage.replaceChildren();
  shown.forEach(one => one.loaded && marcher.free(one.loaded));
  shown = choice.panels.map(panel => {
    const column = document.createElement('div');
    const title = document.createElement('h3');
    title.textContent = panel.name;
    const view = document.createElement('canvas'), slice = document.createElement('canvas');
    view.className = 'view';
    view.tabIndex = 0;
    slice.className = 'slice';
    const reading = document.createElement('p');
    reading.className = 'reading';
    column.append(title, view, slice, reading);
    stage.append(column);
    if (marcher) listen(view); else view.hidden = true;
    const one = { panel, view, slice, reading, loaded: null, read: () => '' };
    slice.addEventListener('pointermove', event =>
      { reading.textContent = one.read(event.offsetX, event.offsetY); });
    return one;
  });
  chooseAxis();
  chooseThreshold();
}

function chooseThreshold() {
  const threshold = Number(controls.threshold.value);
  const sun = towards(radians(pair.sun.zenith), radians(pair.sun.azimuth));
  byId('threshold-value').textContent = `${threshold.toPrecision(3)} ${choice.panels[0].unit}`;
  if (marcher) for (const one of shown) {
    if (one.loaded) marcher.free(one.loaded);
    one.loaded = marcher.load(one.panel, threshold, sun);
  }
  redraw(false);
}

/** The first slice is the fullest one of the first panel, as in figures. */
function chooseAxis() {
  const grid = gridOf(shown[0].panel.volume);
  const [normal] = SECTIONS[controls.axis.value];
  const sums = new Float64Array(grid.n[normal]);
  shown[0].panel.values.forEach((value, voxel) => {
    sums[Math.floor(voxel / grid.steps[normal]) % grid.n[normal]] += Math.abs(value);
  });
  const most = largest(sums), middle = sums.length >> 1;
  const nearest = (best, sum, index) =>
    sum === most && Math.abs(index - middle) < Math.abs(best - middle) ? index : best;
  const value = sums.reduce(nearest, Infinity);
  Object.assign(controls.position, { min: 0, max: sums.length - 1, step: 1, value });
  choosePosition();
}

function choosePosition() {
  const index = Number(controls.position.value);
  const grid = gridOf(shown[0].panel.volume);
  const [normal] = SECTIONS[controls.axis.value];
  const place = grid.low[normal] + (index + 0.5) * grid.voxel[normal];
  byId('position-value').textContent = `${place.toFixed(3)} km`;
  for (const one of shown) one.read = drawSlice(one.slice, one.panel, controls.axis.value, index);
  redraw(controls.cut.checked);
}

/** The view from the side of the Sun, so that lit and shaded parts are visible. */
function reset() {
  const grid = gridOf(shown[0].panel.volume);
  Object.assign(state, { azimuth: radians(pair.sun.azimuth + 75), elevation: 0.32,
    distance: 0.52 * Math.hypot(...grid.size) / Math.tan(0.5 * FIELD_OF_VIEW) });
  redraw(false);
}

/** Draw in the next frame; coarsely while the view moves. */
function redraw(moving) {
  if (moving) state.movedAt = performance.now();
  if (!pending) {
    pending = true;
    requestAnimationFrame(draw);
  }
}

function draw(now) {
  pending = false;
  if (!marcher || !shown.length) return;
  const moving = performance.now() - state.movedAt < STILL_MS;
  if (moving) {
    // Frames of 1000 / 60 ms are not shorter with less to draw.
    const aim = (0.6 * FRAME_MS + 1) / (now - frameAt);
    if (frameAt && (aim > 1 || now - frameAt > FRAME_MS)) state.quality *= Math.min(Math.sqrt(aim), 1.1);
    state.quality = Math.min(Math.max(state.quality, LEAST_QUALITY), 1);
  }
  frameAt = moving ? now : 0;
  const quality = moving ? Math.ceil(10 * state.quality) / 10 : 1;
  for (const one of shown) drawView(one, quality, moving ? 1.5 : 0.5);
  if (moving) redraw(false);
}

function drawView({ panel, view, loaded }, quality, pace) {
  const width = view.clientWidth, height = Math.round(0.8 * width);
  // Where rays are slow, so are pixels: there is no graphics processor.
  const context = fit(view, width, height, quality < 0.6 ? 0.5 : 1);
  const { grid } = loaded;
  const camera = cameraOf(state, add(grid.low, grid.size, 0.5));
  const background = context.createLinearGradient(0, 0, 0, height);
  background.addColorStop(0, panel.sunlit ? '#5b8fc9' : '#f7f7f7');
  background.addColorStop(1, panel.sunlit ? '#c5dcf0' : '#e9e9e9');
  context.fillStyle = background;
  context.fillRect(0, 0, width, height);
  context.strokeStyle = panel.sunlit ? 'rgba(20, 40, 70, 0.55)' : '#888';
  context.fillStyle = '#111';
  drawBox(context, grid, camera, projection(camera, width, height));
  const cut = [0, 0, 0, 0];
  if (controls.cut.checked) {
    const [normal] = SECTIONS[controls.axis.value];
    cut[normal] = 1;
    cut[3] = grid.low[normal] + (Number(controls.position.value) + 0.5) * grid.voxel[normal];
  }
  const ratio = quality * (window.devicePixelRatio || 1);
  const [columns, rows] = [Math.round(width * ratio), Math.round(height * ratio)];
  marcher.draw(loaded, camera, cut, columns, rows, pace);
  context.drawImage(marcher.canvas, 0, 0, width, height);
  const sun = towards(radians(pair.sun.zenith), radians(pair.sun.azimuth));
  drawDirections(context, camera, sun);
}

function turn(right, up) {
  state.azimuth += right;
  state.elevation = Math.min(Math.max(state.elevation + up, -1.5), 1.5);
  redraw(true);
}

function zoom(factor) {
  const size = Math.hypot(...gridOf(shown[0].panel.volume).size);
  state.distance = Math.min(Math.max(state.distance * factor, 0.2 * size), 20 * size);
  redraw(true);
}

function listen(view) {
  view.addEventListener('pointerdown', event => view.setPointerCapture(event.pointerId));
  view.addEventListener('pointermove', event => {
    if (event.buttons & 1) turn(0.008 * event.movementX, 0.008 * event.movementY);
  });
  view.addEventListener('wheel', event => {
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
  }, { passive: false });
  view.addEventListener('keydown', event => {
    const act = { ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, 0.1),
      ArrowDown: () => turn(0, -0.1), '+': () => zoom(0.9), '-': () => zoom(1.1) }[event.key];
    if (act) {
      event.preventDefault();
      act();
    }
  });
}

function begin() {
  for (const [name, act] of Object.entries({ pair: choosePair, field: chooseField, threshold: chooseThreshold,
    axis: chooseAxis, position: choosePosition, cut: () => redraw(false) }))
    controls[name].addEventListener('input', act);
  controls.reset.addEventListener('click', reset);
  window.addEventListener('resize', choosePosition);
}

fill(controls.pair, data.pairs.map(one => one.name));
controls.pair.parentElement.hidden = data.pairs.length < 2;
byId('no-webgl').hidden = Boolean(marcher);
byId('no-streams').hidden = 'DecompressionStream' in window;
if (byId('no-streams').hidden) choosePair().then(begin);
})();
