// Reads an MCAP file with the reader inside Foxglove and Lichtblick, as they would, and prints what it found as JSON.
// usage: node read_log.mjs FILE
import { open } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";

const path = process.argv[2];
const decompressHandlers = await loadDecompressHandlers();

/** One pass from the first byte to the last with every checksum on: the indexed reader follows the index only. */
async function recordTypes() {
  const handle = await open(path);
  const reader = new McapStreamReader({ decompressHandlers, includeChunks: true, validateCrcs: true });
  const counts = {};
  const order = [];
  for await (const piece of handle.createReadStream()) {
    reader.append(piece);
    for (let record; (record = reader.nextRecord()) != undefined; ) {
      counts[record.type] = (counts[record.type] ?? 0) + 1;
      if (record.type === "Metadata") order.push(record.name);
    }
  }
  if (!reader.done()) throw new Error("the file ends too early");
  return { counts, order };
}

const decoders = new Map();

function decoder(schema) {
  if (schema == undefined || schema.encoding !== "protobuf") throw new Error(`a schema is protobuf, not ${schema?.encoding}`);
  if (!decoders.has(schema.id)) {
    const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
    const fields = [...type.fieldsArray].sort((a, b) => a.id - b.id).map((field) => field.name);
    decoders.set(schema.id, { fields, decode: (data) => type.toObject(type.decode(data), { defaults: true, longs: String, enums: String }) });
  }
  return decoders.get(schema.id);
}

const handle = await open(path);
const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(handle), decompressHandlers });

const topics = {};
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  topics[channel.topic] = {
    schema: schema?.name,
    encoding: channel.messageEncoding,
    metadata: Object.fromEntries(channel.metadata),
    fields: decoder(schema).fields,
    logTimes: [],
    publishTimes: [],
    rows: [],
  };
}
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const { fields, decode } = decoder(reader.schemasById.get(channel.schemaId));
  const values = decode(message.data);
  const topic = topics[channel.topic];
  topic.logTimes.push(String(message.logTime));
  topic.publishTimes.push(String(message.publishTime));
  topic.rows.push(fields.map((field) => values[field]));
}

const metadata = {};
for await (const record of reader.readMetadata()) metadata[record.name] = Object.fromEntries(record.metadata);
const attachments = {};
for await (const record of reader.readAttachments({ validateCrcs: true })) attachments[record.name] = Buffer.from(record.data).toString("base64");

console.log(JSON.stringify({ header: reader.header, ...(await recordTypes()), topics, metadata, attachments }));
await handle.close();
