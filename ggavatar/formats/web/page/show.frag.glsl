#version 300 es
// The picture on its background.
precision highp float;

uniform highp sampler2D image;
uniform vec3 background;
out vec4 drawn;

void main() {
  vec4 c = texelFetch(image, ivec2(gl_FragCoord.xy), 0);
  drawn = vec4(c.rgb + (1.0 - c.a) * background, 1.0);
}
