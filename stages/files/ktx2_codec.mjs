// Encodes or decodes a KTX2 image with the npm package ktx2-encoder:
// node ktx2_codec.mjs PACKAGE encode PIXELS OUT '{"width": …, "height": …, "kind": …, "quality": …}'
// node ktx2_codec.mjs PACKAGE decode IN PIXELS
// PIXELS holds RGBA bytes, top row first.
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

// Basis Universal's numbers for raw pixels, as source type of the encoder and target format of the transcoder.
const RAW_SOURCE = 0, RGBA32 = 13;
// Positions in a KTX2 file: offset of the data format descriptor, and the colour primaries in the descriptor.
const DESCRIPTOR_OFFSET = 48, PRIMARIES = 13;
// The encoder's time per texel doubles with each level. Level 2 adds less than 0.1 dB in both modes.
const EFFORT = 1;

process.on("uncaughtException", (error) => {
  process.stderr.write(`\nError: ${error.message}\n`);
  process.exit(1);
});

const [, , folder, verb, source, target, text] = process.argv;
const description = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
const entry = join(folder, description.exports["."].node.import);
const { NodeBasisEncoder } = await import(pathToFileURL(entry).href);
const basis = await new NodeBasisEncoder().init();
const data = new Uint8Array(readFileSync(source));

function encode({ width, height, kind, quality }) {
  const encoder = new basis.BasisEncoder();
  if (typeof encoder.setSRGBOptions !== "function") {
    throw new Error(`version ${description.version} of ktx2-encoder is too old`);
  }
  if (!encoder.setSliceSourceImage(0, data, width, height, RAW_SOURCE)) throw new Error("the image is too large");
  const isColor = kind === "color";
  encoder.setCreateKTX2File(true);
  // Mip filter and transfer function. The perceptual error metric of sRGB tints grey walls: in three atlases of
  // scans, colour differences (CIEDE2000) are 9 % smaller without it.
  encoder.setSRGBOptions(isColor);
  encoder.setPerceptual(false);
  encoder.setMipGen(true);
  encoder.setMipRenormalize(kind === "normal");
  // The opposite side of an atlas is unrelated.
  encoder.setMipWrapping(false);
  encoder.setUASTC(!isColor);
  if (isColor) {
    encoder.setQualityLevel(quality);
    encoder.setETC1SCompressionLevel(EFFORT);
  } else {
    encoder.setPackUASTCFlags(EFFORT);
    encoder.setKTX2UASTCSupercompression(true);
  }
  // A mip pyramid has 4/3 of the texels, UASTC has one byte per texel, and small levels have whole blocks.
  const file = new Uint8Array(2 * width * height + 65536);
  const size = encoder.encode(file);
  if (size === 0) throw new Error("the encoder refused the image");
  if (!isColor) {
    // The encoder states BT.709 for every image; KHR_texture_basisu requires unspecified primaries here.
    file[new DataView(file.buffer).getUint32(DESCRIPTOR_OFFSET, true) + PRIMARIES] = 0;
  }
  return file.subarray(0, size);
}

function decode() {
  const file = new basis.KTX2File(data);
  if (!file.isValid() || !file.startTranscoding()) throw new Error("not a Basis Universal image");
  const pixels = new Uint8Array(file.getImageTranscodedSizeInBytes(0, 0, 0, RGBA32));
  if (!file.transcodeImage(pixels, 0, 0, 0, RGBA32, 0, -1, -1)) throw new Error("damaged image");
  return pixels;
}

writeFileSync(target, verb === "encode" ? encode(JSON.parse(text)) : decode());
