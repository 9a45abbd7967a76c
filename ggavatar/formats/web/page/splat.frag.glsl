#version 300 es
// A Gaussian's weight in a pixel, blended front to back: colors come multiplied by their alpha.
precision highp float;

flat in vec2 center;
flat in vec3 conic;
flat in vec4 color;
uniform vec2 size;
out vec4 drawn;

void main() {
  vec2 d = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y) - center;
  float alpha = color.a * exp(-0.5 * (conic.x * d.x * d.x + conic.z * d.y * d.y) - conic.y * d.x * d.y);
  if (alpha < 1.0 / 255.0) discard;
  alpha = min(alpha, 0.99);
  drawn = vec4(color.rgb * alpha, alpha);
}
