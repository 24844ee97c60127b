const SKINNING = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in uvec4 joints;
layout(location = 3) in vec4 weights;
uniform vec4 bones[72];
uniform float unit;
void skin(out vec3 place, out vec3 facing) {
  vec4 at = vec4(position * unit, 1.0);
  place = vec3(0.0);
  facing = vec3(0.0);
  for (int k = 0; k < 4; k++) {
    int row = 3 * int(joints[k]);
    vec4 x = bones[row], y = bones[row + 1], z = bones[row + 2];
    place += weights[k] * vec3(dot(x, at), dot(y, at), dot(z, at));
    facing += weights[k] * vec3(dot(x.xyz, normal), dot(y.xyz, normal), dot(z.xyz, normal));
  }
}
`;

// How much of the key light arrives: sixteen looks at the shadow map on a turned spiral, so that edges are soft.
const SHADOW = `
float lit(highp sampler2DShadow map, vec4 at, float spread) {
  vec3 p = at.xyz / at.w * 0.5 + 0.5;
  if (any(lessThan(p, vec3(0.0))) || any(greaterThan(p, vec3(1.0)))) return 1.0;
  float turn = 6.2831853 * fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
  float sum = 0.0;
  for (int k = 0; k < 16; k++) {
    float radius = sqrt((float(k) + 0.5) / 16.0), angle = turn + float(k) * 2.3999632;
    sum += texture(map, vec3(p.xy + spread * radius * vec2(cos(angle), sin(angle)), p.z));
  }
  return sum / 16.0;
}
`;

const BODY_VERTEX = `${SKINNING}
uniform vec3 tints[24];
uniform mat4 camera, light;
out vec3 place, facing, tint;
out vec4 shaded;
void main() {
  skin(place, facing);
  tint = vec3(0.0);
  for (int k = 0; k < 4; k++) tint += weights[k] * tints[joints[k]];
  shaded = light * vec4(place + 0.012 * normalize(facing), 1.0);
  gl_Position = camera * vec4(place, 1.0);
}`;

// Colours come and go as sRGB; light is added up in between.
const BODY_FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
in vec3 place, facing, tint;
in vec4 shaded;
uniform sampler2DShadow map;
uniform vec3 eye, key, sky, ground;
uniform float strength, rim, opacity;
out vec4 colour;
${SHADOW}
void main() {
  vec3 n = normalize(facing), view = normalize(eye - place);
  float towards = dot(n, key);
  float direct = clamp((towards + 0.25) / 1.25, 0.0, 1.0) * mix(0.25, 1.0, lit(map, shaded, 0.006));
  vec3 around = mix(ground, sky, 0.5 + 0.5 * n.y) * mix(0.78, 1.0, smoothstep(0.0, 0.7, place.y));
  vec3 albedo = pow(tint, vec3(2.2));
  float edge = pow(1.0 - max(dot(n, view), 0.0), 3.5);
  float gloss = pow(max(dot(n, normalize(key + view)), 0.0), 36.0) * 0.10 * step(0.0, towards);
  vec3 light = albedo * (around + strength * direct) + rim * edge * sky * (0.55 + 0.45 * n.y) + gloss * direct;
  colour = vec4(pow(light / (1.0 + 0.12 * light), vec3(1.0 / 2.2)), 1.0) * opacity;
}`;

const SHADOW_VERTEX = `${SKINNING}
uniform mat4 light;
void main() {
  vec3 place, facing;
  skin(place, facing);
  gl_Position = light * vec4(place, 1.0);
}`;
const SHADOW_FRAGMENT = `#version 300 es
precision highp float;
void main() {}`;

const FLOOR_VERTEX = `#version 300 es
uniform mat4 camera, light;
uniform vec3 centre;
uniform float reach;
out vec3 place;
out vec4 shaded;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  place = vec3(centre.x + reach * corner.x, 0.0, centre.z + reach * corner.y);
  shaded = light * vec4(place, 1.0);
  gl_Position = camera * vec4(place, 1.0);
}`;
const FLOOR_FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DShadow;
in vec3 place;
in vec4 shaded;
uniform sampler2DShadow map;
uniform vec3 centre, below, base, line, shade;
uniform float reach, shadow;
out vec4 colour;
${SHADOW}
float grid(vec2 at, float width) {
  vec2 size = fwidth(at), off = abs(fract(at - 0.5) - 0.5);
  vec2 lines = 1.0 - smoothstep(size * width * 0.5, size * (width * 0.5 + 1.0), off);
  return max(lines.x, lines.y) * (1.0 - smoothstep(0.15, 0.5, max(size.x, size.y)));
}
void main() {
  float far = length(place.xz - centre.xz) / reach;
  float fade = 1.0 - smoothstep(0.18, 1.0, far);
  float lines = max(0.45 * grid(place.xz * 2.0, 1.0), grid(place.xz, 1.2));
  float near = length(place.xz - below.xz);
  float dark = shadow * (1.0 - lit(map, shaded, 0.010)) + 0.22 * exp(-near * near * 9.0) * exp(-max(below.y - 0.9, 0.0) * 3.0);
  vec3 mixed = mix(mix(base, line, lines * 0.38), shade, clamp(dark, 0.0, 1.0));
  colour = vec4(mixed, 1.0) * fade;
}`;

const BACK_VERTEX = `#version 300 es
out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  at = corner;
  gl_Position = vec4(corner, 0.0, 1.0);
}`;
const BACK_FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
uniform vec3 inner, outer;
out vec4 colour;
void main() {
  float far = length(at * vec2(0.75, 0.9) - vec2(0.0, 0.15));
  float grain = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) / 255.0;
  colour = vec4(mix(inner, outer, smoothstep(0.1, 1.25, far)) + grain, 1.0);
}`;

// Round-ended lines of a width in pixels; a line without length is a dot.
const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 start;
layout(location = 1) in vec3 end;
layout(location = 2) in vec4 tint;
layout(location = 3) in float width;
uniform mat4 camera;
uniform vec2 pixels;
out vec4 ink;
out vec2 at;
flat out float span, half_width;
void main() {
  vec4 a = camera * vec4(start, 1.0), b = camera * vec4(end, 1.0);
  vec2 from = a.xy / a.w * pixels * 0.5, to = b.xy / b.w * pixels * 0.5;
  vec2 along = to - from;
  span = length(along);
  vec2 way = span > 0.001 ? along / span : vec2(1.0, 0.0), side = vec2(-way.y, way.x);
  half_width = width * 0.5;
  float out_by = half_width + 1.0;
  bool last = (gl_VertexID & 1) == 1;
  float across = (gl_VertexID >> 1) == 1 ? out_by : -out_by;
  at = vec2(last ? span + out_by : -out_by, across);
  vec2 place = from + way * at.x + side * across;
  float w = last ? b.w : a.w;
  gl_Position = vec4(place / (pixels * 0.5) * w, (last ? b.z : a.z), w);
  ink = a.w > 0.05 && b.w > 0.05 ? tint : vec4(0.0);
}`;
const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec4 ink;
in vec2 at;
flat in float span, half_width;
out vec4 colour;
void main() {
  float away = length(vec2(at.x - clamp(at.x, 0.0, span), at.y));
  float alpha = ink.a * clamp(half_width - away + 0.5, 0.0, 1.0);
  colour = vec4(ink.rgb, 1.0) * alpha;
}`;

// A picture of the loop, standing in the world; its paper is nearly clear.
const PICTURE_VERTEX = `#version 300 es
layout(location = 0) in vec3 corner;
uniform mat4 camera;
uniform vec4 window;
out vec2 at;
void main() {
  vec2 uv = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  at = window.xy + uv * window.zw;
  gl_Position = camera * vec4(corner, 1.0);
}`;
const PICTURE_FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
uniform sampler2D sheet;
uniform vec3 paper;
uniform float veil;
out vec4 colour;
void main() {
  vec3 seen = texture(sheet, at).rgb;
  float covered = clamp(2.2 * distance(seen, paper), 0.0, 1.0);
  vec3 pure = clamp(paper + (seen - paper) / max(covered, 0.05), 0.0, 1.0); // what the paper shone through
  colour = mix(vec4(paper, 1.0) * veil, vec4(pure, 1.0) * 0.88, covered);
}`;
