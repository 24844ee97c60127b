// What Khronos' validator says: node validate.cjs NODE_MODULES FILE prints the counts and messages as JSON.
const fs = require('node:fs');
const path = require('node:path');

const [modules, file] = process.argv.slice(2);
const validator = require(path.join(modules, 'gltf-validator'));
validator.validateBytes(new Uint8Array(fs.readFileSync(file))).then(
  (report) => console.log(JSON.stringify(report.issues)),
  (error) => { console.error(error); process.exit(1); },
);
