// Calls that count, for counts of one size: see count_messages.c, which defines
// COUNT, DISPLACEMENT, CALL and PROFILED.

// One message to each neighbour that gets something.
static void CALL(neighbours)(const COUNT n[], MPI_Datatype t, MPI_Comm c)
{
  int in = 0, out = 0, weighted = 0;
  PMPI_Dist_graph_neighbors_count(c, &in, &out, &weighted);
  for (int i = 0; i < out; ++i)
    if (n[i])
      message(n[i], t);
}

int CALL(Send)(const void* b, COUNT n, MPI_Datatype t, int to, int tag, MPI_Comm c)
{
  message(n, t);
  return PROFILED(Send)(b, n, t, to, tag, c);
}

int CALL(Isend)(const void* b, COUNT n, MPI_Datatype t, int to, int tag, MPI_Comm c, MPI_Request* r)
{
  message(n, t);
  return PROFILED(Isend)(b, n, t, to, tag, c, r);
}

int CALL(Issend)(const void* b, COUNT n, MPI_Datatype t, int to, int tag, MPI_Comm c,
                 MPI_Request* r)
{
  message(n, t);
  return PROFILED(Issend)(b, n, t, to, tag, c, r);
}

int CALL(Sendrecv)(const void* b, COUNT n, MPI_Datatype t, int to, int tag, void* rb, COUNT rn,
                   MPI_Datatype rt, int from, int rtag, MPI_Comm c, MPI_Status* s)
{
  message(n, t);
  return PROFILED(Sendrecv)(b, n, t, to, tag, rb, rn, rt, from, rtag, c, s);
}

int CALL(Neighbor_alltoallv)(const void* b, const COUNT n[], const DISPLACEMENT d[], MPI_Datatype t,
                             void* rb, const COUNT rn[], const DISPLACEMENT rd[], MPI_Datatype rt,
                             MPI_Comm c)
{
  CALL(neighbours)(n, t, c);
  return PROFILED(Neighbor_alltoallv)(b, n, d, t, rb, rn, rd, rt, c);
}

int CALL(Ineighbor_alltoallv)(const void* b, const COUNT n[], const DISPLACEMENT d[],
                              MPI_Datatype t, void* rb, const COUNT rn[], const DISPLACEMENT rd[],
                              MPI_Datatype rt, MPI_Comm c, MPI_Request* r)
{
  CALL(neighbours)(n, t, c);
  return PROFILED(Ineighbor_alltoallv)(b, n, d, t, rb, rn, rd, rt, c, r);
}

int CALL(Allreduce)(const void* b, void* rb, COUNT n, MPI_Datatype t, MPI_Op op, MPI_Comm c)
{
  collective(n, t);
  return PROFILED(Allreduce)(b, rb, n, t, op, c);
}

int CALL(Iallreduce)(const void* b, void* rb, COUNT n, MPI_Datatype t, MPI_Op op, MPI_Comm c,
                     MPI_Request* r)
{
  collective(n, t);
  return PROFILED(Iallreduce)(b, rb, n, t, op, c, r);
}

int CALL(Reduce)(const void* b, void* rb, COUNT n, MPI_Datatype t, MPI_Op op, int root, MPI_Comm c)
{
  collective(n, t);
  return PROFILED(Reduce)(b, rb, n, t, op, root, c);
}

int CALL(Bcast)(void* b, COUNT n, MPI_Datatype t, int root, MPI_Comm c)
{
  collective(n, t);
  return PROFILED(Bcast)(b, n, t, root, c);
}

int CALL(Allgather)(const void* b, COUNT n, MPI_Datatype t, void* rb, COUNT rn, MPI_Datatype rt,
                    MPI_Comm c)
{
  collective(n, t);
  return PROFILED(Allgather)(b, n, t, rb, rn, rt, c);
}

int CALL(Allgatherv)(const void* b, COUNT n, MPI_Datatype t, void* rb, const COUNT rn[],
                     const DISPLACEMENT d[], MPI_Datatype rt, MPI_Comm c)
{
  collective(n, t);
  return PROFILED(Allgatherv)(b, n, t, rb, rn, d, rt, c);
}

int CALL(Alltoall)(const void* b, COUNT n, MPI_Datatype t, void* rb, COUNT rn, MPI_Datatype rt,
                   MPI_Comm c)
{
  int size = 0;
  PMPI_Comm_size(c, &size);
  collective((double)n * size, t);
  return PROFILED(Alltoall)(b, n, t, rb, rn, rt, c);
}

int CALL(Alltoallv)(const void* b, const COUNT n[], const DISPLACEMENT d[], MPI_Datatype t,
                    void* rb, const COUNT rn[], const DISPLACEMENT rd[], MPI_Datatype rt,
                    MPI_Comm c)
{
  int size = 0;
  double total = 0;
  PMPI_Comm_size(c, &size);
  for (int i = 0; i < size; ++i)
    total += n[i];
  collective(total, t);
  return PROFILED(Alltoallv)(b, n, d, t, rb, rn, rd, rt, c);
}
