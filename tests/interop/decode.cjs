// What node-mavlink makes of a recorded stream: `node decode.cjs FILE` prints one JSON object.
//
// It uses the messages that the package was published with (minimal, standard, common): what lies outside them is counted
// as unknown, and a frame with a wrong checksum as invalid.
"use strict";

const { createReadStream } = require("node:fs");
const { MavLinkPacketParser, MavLinkPacketSplitter, common, minimal, standard } = require("node-mavlink");

const registry = { ...minimal.REGISTRY, ...standard.REGISTRY, ...common.REGISTRY };
const splitter = new MavLinkPacketSplitter();
const counts = {};
const attitudes = [];
let undecoded = 0;

createReadStream(process.argv[2])
  .pipe(splitter)
  .pipe(new MavLinkPacketParser())
  .on("data", (packet) => {
    const type = registry[packet.header.msgid];
    if (type === undefined) {
      undecoded += 1;
      return;
    }
    const message = packet.protocol.data(packet.payload, type);
    counts[type.MSG_NAME] = (counts[type.MSG_NAME] ?? 0) + 1;
    if (type.MSG_NAME === "ATTITUDE") {
      attitudes.push([message.timeBootMs, message.pitch, message.pitchspeed]);
    }
  })
  .on("end", () => {
    const { invalidPackages: invalid, unknownPackagesCount: unknown } = splitter;
    process.stdout.write(JSON.stringify({ counts, attitudes, invalid, unknown, undecoded }) + "\n");
  });
