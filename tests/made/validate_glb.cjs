// Prints what the Khronos validator says of each GLB file of a folder: node validate_glb.cjs PAGE FOLDER
const { readdirSync, readFileSync } = require("node:fs");
const { join } = require("node:path");
const [, , page, folder] = process.argv;
const { validateBytes } = require(require.resolve("gltf-validator", { paths: [page] }));

(async () => {
  const said = {};
  for (const name of readdirSync(folder)) {
    const { issues } = await validateBytes(new Uint8Array(readFileSync(join(folder, name))));
    said[name] = issues.messages;
  }
  process.stdout.write(JSON.stringify(said));
})();
