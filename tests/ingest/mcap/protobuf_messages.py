"""Classes of protobuf, without their generated modules."""

from collections.abc import Mapping

from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass


def message_class(full_name, fields: Mapping[str, str]):
    """A message with fields of these types, numbered from 1; "DOUBLE*" is a sequence of them.

    A "Timestamp" is google.protobuf.Timestamp.
    """
    package, name = full_name.split(".")
    file = FileDescriptorProto(name=f"{name}.proto", package=package, syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    message = file.message_type.add(name=name)
    for number, (field_name, type_name) in enumerate(fields.items(), 1):
        field = message.field.add(
            name=field_name,
            number=number,
            label=Field.LABEL_OPTIONAL,
        )
        if type_name == "Timestamp":
            field.type = Field.TYPE_MESSAGE
            field.type_name = ".google.protobuf.Timestamp"
        else:
            field.type = Field.Type.Value(f"TYPE_{type_name.rstrip('*')}")
        if type_name.endswith("*"):
            field.label = Field.LABEL_REPEATED
    pool = DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(full_name))
