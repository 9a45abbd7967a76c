#version 300 es
// One Gaussian, projected as in ggavatar/render/projection.py; the four corners of its quad come by gl_VertexID.
precision highp float;
precision highp int;
precision highp sampler2D;

layout(location = 0) in uint index;

uniform sampler2D placed;      // POSED texels a Gaussian: mean 3 and scale 1, scale 2, quaternion, change of color
uniform sampler2D appearance;  // COEFFICIENTS texels a Gaussian: harmonics, the opacity beside the first
uniform mat4 view;             // world to camera
uniform vec4 camera;           // focal lengths and principal point, px
uniform vec2 size;             // of the picture, px
uniform vec3 eye;              // the camera in the world

flat out vec2 center;  // px
flat out vec3 conic;   // xx, xy, yy of the inverse covariance, 1/px^2
flat out vec4 color;

const float NEAR = 0.01;
const float LOW_PASS = 0.3;
const float CLAMP_MARGIN = 0.15;  // of the whole side
const float MIN_ALPHA = 1.0 / 255.0;
const float C0 = 0.28209479177387814;
const float C1 = 0.4886025119029199;

vec4 texel(sampler2D source, int i) {
  return texelFetch(source, ivec2(i % TEXTURE_WIDTH, i / TEXTURE_WIDTH), 0);
}

vec3 harmonic(int g, int k) {
  return texel(appearance, COEFFICIENTS * g + k).rgb;
}

vec3 radiance(int g, vec3 n) {
  float x = n.x, y = n.y, z = n.z;
  vec3 sum = C0 * harmonic(g, 0);
#if COEFFICIENTS > 1
  sum += C1 * (-y * harmonic(g, 1) + z * harmonic(g, 2) - x * harmonic(g, 3));
#endif
#if COEFFICIENTS > 4
  sum += 1.0925484305920792 * (x * y * harmonic(g, 4) - y * z * harmonic(g, 5) - x * z * harmonic(g, 7));
  sum += 0.31539156525252005 * (2.0 * z * z - x * x - y * y) * harmonic(g, 6);
  sum += 0.5462742152960396 * (x * x - y * y) * harmonic(g, 8);
#endif
#if COEFFICIENTS > 9
  sum += -0.5900435899266435 * (y * (3.0 * x * x - y * y) * harmonic(g, 9) + x * (x * x - 3.0 * y * y) * harmonic(g, 15));
  sum += 2.890611442640554 * x * y * z * harmonic(g, 10) + 1.445305721320277 * z * (x * x - y * y) * harmonic(g, 14);
  sum += -0.4570457994644658 * (4.0 * z * z - x * x - y * y) * (y * harmonic(g, 11) + x * harmonic(g, 13));
  sum += 0.3731763325901154 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y) * harmonic(g, 12);
#endif
  return sum + 0.5;
}

mat3 rotation(vec4 q) {
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

void main() {
  int g = int(index);
  vec4 first = texel(placed, POSED * g), second = texel(placed, POSED * g + 1);
  vec3 mean = first.xyz, scale = vec3(first.w, second.xy);
  float opacity = texel(appearance, COEFFICIENTS * g).a;
  vec3 p = (view * vec4(mean, 1.0)).xyz;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside: nothing is drawn
  if (!(p.z > NEAR) || opacity < MIN_ALPHA) return;

  vec2 focal = camera.xy, middle = camera.zw;
  vec2 margin = CLAMP_MARGIN * size / focal;
  vec2 ratio = clamp(p.xy / p.z, -middle / focal - margin, (size - middle) / focal + margin);
  mat3 turned = mat3(view) * rotation(texel(placed, POSED * g + 2));
  vec3 rowX = vec3(turned[0].x, turned[1].x, turned[2].x), rowY = vec3(turned[0].y, turned[1].y, turned[2].y);
  vec3 rowZ = vec3(turned[0].z, turned[1].z, turned[2].z);
  vec3 a = focal.x / p.z * (rowX - ratio.x * rowZ) * scale, b = focal.y / p.z * (rowY - ratio.y * rowZ) * scale;
  float aa = dot(a, a), bb = dot(b, b), xy = dot(a, b);
  float xx = aa + LOW_PASS, yy = bb + LOW_PASS;
  vec3 minors = cross(a, b);  // the determinant without the cancellation that makes thin Gaussians vanish
  float determinant = dot(minors, minors) + LOW_PASS * (aa + bb) + LOW_PASS * LOW_PASS;
  conic = vec3(yy, -xy, xx) / determinant;
  center = focal * p.xy / p.z + middle;

  float reach = 2.0 * log(opacity / MIN_ALPHA);  // squared distance, in standard deviations, at which alpha ends
  float mean2 = 0.5 * (xx + yy);
  float larger = mean2 + sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.0));
  vec2 along = abs(xy) > 1e-6 * mean2 ? normalize(vec2(xy, larger - xx)) : (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
  vec2 corner = vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID >> 1) * 2 - 1);
  vec2 half_axes = sqrt(reach * vec2(larger, determinant / larger)) + 0.5;
  vec2 place = center + along * corner.x * half_axes.x + vec2(-along.y, along.x) * corner.y * half_axes.y;

  vec3 rgb = radiance(g, normalize(mean - eye));
#if POSED > 3
  rgb += C0 * texel(placed, POSED * g + 3).rgb;
#endif
  color = vec4(max(rgb, 0.0), opacity);
  gl_Position = vec4(place.x / size.x * 2.0 - 1.0, 1.0 - place.y / size.y * 2.0, 0.0, 1.0);
}
