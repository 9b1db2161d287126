// Decodes frames from standard input with node-mavlink and prints each ODOMETRY as a line of JSON.
import { createRequire } from "node:module";

// The modules lie beside the lock file's copy, not beside this file.
const { MavLinkPacketSplitter, MavLinkPacketParser, common } = createRequire(`${process.env.PEERS_NODE}/`)("node-mavlink");

const packets = process.stdin.pipe(new MavLinkPacketSplitter()).pipe(new MavLinkPacketParser());
for await (const packet of packets) {
  if (packet.header.msgid !== common.Odometry.MSG_ID) continue;
  const odometry = packet.protocol.data(packet.payload, common.Odometry);
  const fields = Object.fromEntries(common.Odometry.FIELDS.map((field) => [field.source, odometry[field.name]]));
  const from = { sysid: packet.header.sysid, compid: packet.header.compid, seq: packet.header.seq };
  // JSON has neither 64-bit integers nor NaN.
  const plain = (_, value) => (typeof value === "bigint" ? Number(value) : Number.isNaN(value) ? null : value);
  console.log(JSON.stringify({ ...from, ...fields }, plain));
}
